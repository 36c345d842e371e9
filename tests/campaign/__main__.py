"""Damage, kills and accidents at random, and what became of them: ``make campaign``.

    python tests/campaign [key=value ...]

Every case is a function of the seed and its number, in a forked process whose time and memory are
bounded. Interrupted, the same command goes on; more cases are added to those that are done.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE.parent / "data"), str(HERE)]

import random  # noqa: E402
import shutil  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from collections import Counter  # noqa: E402
from collections.abc import Callable  # noqa: E402
from dataclasses import dataclass  # noqa: E402
from typing import Any  # noqa: E402

import accidents  # noqa: E402
from cases import FINDINGS, Outcome, run_case  # noqa: E402
from readers import READERS, Reader, spoil  # noqa: E402
from tables import describe, place  # noqa: E402

from common.command import command  # noqa: E402
from common.documents import read_json  # noqa: E402
from common.files import replace_json  # noqa: E402
from experiments.result import REPORTS, machine  # noqa: E402

REPORT = REPORTS / "campaign.json"
KEPT = 40  # findings of a reader that are listed
EVERY = 5.0  # s between two looks at the disk


@dataclass
class CampaignConfig:
    """``configs/campaign.yaml``."""

    corrupted: int
    fuzz_s: float
    kills: int
    pool_kills: int
    training_kills: int
    accidents: int
    readers: str
    seed: int
    work: str
    out: str


@command("campaign", CampaignConfig)
def main(config: CampaignConfig) -> None:
    """Do what is missing of the campaign, and write the report."""
    work, out = Path(config.work), Path(config.out or REPORT)
    work.mkdir(parents=True, exist_ok=True)
    chosen = config.readers.split("|") if config.readers else list(READERS)
    readers = {name: fuzz(name, READERS[name], config, work) for name in chosen}
    killed = {kind: kills(kind, count, config, work) for kind, count in (
        ("kills", config.kills), ("pool_kills", config.pool_kills),
        ("training_kills", config.training_kills))}
    hurt = {kind: hurts(kind, config, work) for kind in accidents.ACCIDENTS if config.accidents}
    content = {"seed": config.seed, "readers": readers, "kills": killed, "accidents": hurt}
    replace_json(out, {"machine": machine(), **content})
    if out == REPORT:
        place(content, REPORTS.parent / "validation.md")
    print(describe(content))


def _resumed(file: Path, empty: dict[str, Any]) -> dict[str, Any]:
    return read_json(file) if file.exists() else empty


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)


def fuzz(name: str, reader: Reader, config: CampaignConfig, work: Path) -> dict[str, Any]:
    """Damaged inputs of a reader."""
    file = work / f"reader_{_plain(name)}.json"
    done = _resumed(file, {"cases": 0, "seconds": 0.0, "outcomes": {}, "most_seconds": 0.0,
                           "most_megabytes": 0.0, "findings": []})
    if done["cases"] >= config.corrupted and done["seconds"] >= config.fuzz_s:
        return done
    saved = time.monotonic()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as root:
        sound = Path(root) / "sound"
        sound.mkdir()
        reader.make(sound)
        whole = run_case(lambda: reader.read(sound))
        if whole.kind != "accepted":
            raise RuntimeError(f"{name}: what is sound is not taken: {whole}")
        while done["cases"] < config.corrupted or done["seconds"] < config.fuzz_s:
            _book(done, case(name, reader, sound, f"{config.seed}:{name}:{done['cases']}"))
            if time.monotonic() - saved > EVERY:
                replace_json(file, done)
                saved = time.monotonic()
    replace_json(file, done)
    print(f"{name}: {done['cases']} damaged, {done['outcomes']}", flush=True)
    return done


def case(name: str, reader: Reader, sound: Path, key: str) -> tuple[str, str, Outcome]:
    """One damaged input: its key, the file damaged, and what became of it."""
    folder = sound.with_name("case")
    shutil.copytree(sound, folder)
    try:
        hurt = spoil(reader, folder, random.Random(key))
        return key, hurt, run_case(lambda: reader.read(folder))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _book(done: dict[str, Any], found: tuple[str, str, Outcome]) -> None:
    key, hurt, outcome = found
    done["cases"] += 1
    done["seconds"] += outcome.seconds
    done["outcomes"][outcome.kind] = done["outcomes"].get(outcome.kind, 0) + 1
    done["most_seconds"] = max(done["most_seconds"], round(outcome.seconds, 2))
    done["most_megabytes"] = max(done["most_megabytes"], round(outcome.megabytes))
    if outcome.kind in FINDINGS and len(done["findings"]) < KEPT:
        done["findings"].append([key, hurt, outcome.kind, outcome.message])


def kills(kind: str, count: int, config: CampaignConfig, work: Path) -> dict[str, Any]:
    """Runs that are killed until there have been ``count`` kills."""
    ways: dict[str, Callable[[Path, random.Random], dict]] = {
        "kills": accidents.kill_dataset, "training_kills": accidents.kill_training,
        "pool_kills": lambda place, rng: accidents.kill_dataset(place, rng, workers=2)}
    file = work / f"{kind}.json"
    done = _resumed(file, {"kills": 0, "runs": 0, "same": 0, "failed": []})
    while done["kills"] < count:
        place = work / kind
        place.mkdir(exist_ok=True)
        found = ways[kind](place, random.Random(f"{config.seed}:{kind}:{done['runs']}"))
        done["runs"] += 1
        done["kills"] += found["kills"]
        done["same"] += found["same"]
        done["failed"] += found["failed"]
        replace_json(file, done)
    print(f"{kind}: {done}", flush=True)
    return done


def hurts(kind: str, config: CampaignConfig, work: Path) -> dict[str, Any]:
    """Accidents of one kind."""
    file = work / f"accident_{_plain(kind)}.json"
    done = _resumed(file, {"cases": 0, "wrong": {}})
    place = Path(tempfile.mkdtemp())
    try:
        while done["cases"] < config.accidents:
            rng = random.Random(f"{config.seed}:{kind}:{done['cases']}")
            wrong = accidents.accident(kind, place, rng)
            done["cases"] += 1
            if wrong:
                done["wrong"] = dict(Counter(done["wrong"]) + Counter([wrong]))
            replace_json(file, done)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    print(f"{kind}: {done}", flush=True)
    return done


if __name__ == "__main__":
    main()
