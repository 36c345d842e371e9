"""Damage, kills and accidents at random, and what became of them: ``make campaign``.

    python tests/campaign [key=value ...]

Every case is a function of the seed and its number, in a forked process whose time and memory are
bounded. Prints a line for each reader and kind of accident; a finding is exit code 2.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE.parent / "data"), str(HERE)]

import random  # noqa: E402
import shutil  # noqa: E402
import tempfile  # noqa: E402
from collections import Counter  # noqa: E402
from dataclasses import dataclass  # noqa: E402

import accidents  # noqa: E402
from cases import FINDINGS, run_case  # noqa: E402
from readers import READERS, Reader, spoil  # noqa: E402

from common.command import command  # noqa: E402
from common.errors import InputError  # noqa: E402

KILLS = {"kills": accidents.kill_dataset, "pool_kills": accidents.kill_dataset_with_workers,
         "training_kills": accidents.kill_training}


@dataclass
class CampaignConfig:
    """``configs/campaign.yaml``."""

    corrupted: int
    kills: int
    pool_kills: int
    training_kills: int
    accidents: int
    readers: str
    seed: int


@command("campaign", CampaignConfig)
def main(config: CampaignConfig) -> None:
    """Run all cases."""
    findings = 0
    with tempfile.TemporaryDirectory() as root:
        place = Path(root)
        place.chmod(0o755)
        for name in config.readers.split("|") if config.readers else READERS:
            findings += damage(name, READERS[name], config, place)
        for kind, kill in KILLS.items():
            findings += kills(kind, kill, config, place)
        for kind in accidents.ACCIDENTS if config.accidents else ():
            rng = random.Random(f"{config.seed}:{kind}")
            wrong = Counter(accidents.accident(kind, place, rng) for _ in range(config.accidents))
            findings += config.accidents - wrong.pop("", 0)
            print(f"{kind}: {config.accidents} runs, wrong: {dict(wrong)}", flush=True)
    if findings:
        raise InputError(f"{findings} findings")


def damage(name: str, reader: Reader, config: CampaignConfig, place: Path) -> int:
    """Read damaged inputs; the number of findings."""
    sound, folder = place / "sound", place / "case"
    sound.mkdir()
    reader.make(sound)
    if (whole := run_case(lambda: reader.read(sound))).kind != "accepted":
        raise RuntimeError(f"{name}: a sound input is refused: {whole}")
    outcomes: Counter[str] = Counter()
    for number in range(config.corrupted):
        shutil.copytree(sound, folder)
        file = spoil(reader, folder, random.Random(f"{config.seed}:{name}:{number}"))
        outcome = run_case(lambda: reader.read(folder))
        outcomes[outcome.kind] += 1
        if outcome.kind in FINDINGS:
            print(f"{name}, number {number}, {file}: {outcome.kind} {outcome.message}", flush=True)
        shutil.rmtree(folder, ignore_errors=True)
    shutil.rmtree(sound)
    print(f"{name}: {dict(outcomes)}", flush=True)
    return sum(outcomes[kind] for kind in FINDINGS)


def kills(
    kind: str, kill: accidents.Kill, config: CampaignConfig, place: Path
) -> int:
    """Kill runs until there have been enough kills; the number of findings."""
    done = runs = wrong = 0
    folder = place / kind
    folder.mkdir()
    while done < getattr(config, kind):
        outcome = kill(folder, random.Random(f"{config.seed}:{kind}:{runs}"))
        done, runs = done + outcome["kills"], runs + 1
        if not outcome["same"] or outcome["failed"]:
            wrong += 1
            print(f"{kind}, run {runs - 1}: {outcome}", flush=True)
    print(f"{kind}: {done} in {runs} runs, {wrong} of them wrong", flush=True)
    return wrong


if __name__ == "__main__":
    main()
