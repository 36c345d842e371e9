"""Estimation of a folder of raw frames by one command, with and without interruptions.

Scans of real fabrics are rendered in synthetic scenes (:mod:`data.scenes`) and written as raw
frames, FABRIC/SAMPLE/CAPTURE. ``infer.py captures=`` estimates them once without interruption and
once killed and restarted twice; both must give the same tables.
"""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.common import ROOT, Config, Result, table
from benchmarks.estimation.real_captures import Specimen, agreement
from common.errors import InputError
from data.captures import write_capture
from data.render import QUARTERS
from data.scans import read_scan
from data.scenes import CLUTTER, raw_scene
from drapenet.output import DONE
from drapenet.overview import ROLES
from sim.material import REFERENCE_DENSITY
from sim.scene import DISC_RIG

KILLS = (0.2, 0.6)  # shares of the captures that are finished when the run is killed
TABLES = ("fabrics.csv", "captures.csv", "failures.csv")


def make_tree(scans: list[Path], root: Path, *, sensor: str, seed: int) -> None:
    """Write raw frames of every scan; existing captures are kept."""
    for path in tqdm(scans, desc="frames", mininterval=10):
        name = Specimen.from_scan_name(path.stem)
        folder = root / f"fabric_{name.fabric}" / f"sample_{name.sample}" / f"{name.capture}"
        if folder.exists():
            continue
        scan = read_scan(path, DISC_RIG)
        rng = np.random.default_rng([seed, name.fabric, name.sample, name.capture])
        turns = np.array(QUARTERS) + np.radians(rng.uniform(-3, 3, len(QUARTERS)))
        scene = raw_scene(scan.positions, scan.faces, rng, rig=DISC_RIG, turns=turns - turns[0],
                          sensor=sensor, clutter=str(rng.choice(list(CLUTTER))))
        write_capture(folder, views=scene.frames, intrinsics=scene.camera.intrinsics,
                      density=REFERENCE_DENSITY, rig=DISC_RIG, depth_unit=1e-4)


def command(root: Path, out: Path) -> list[str]:
    """Command line that estimates the captures in ``root``."""
    return [sys.executable, str(ROOT / "infer.py"), f"captures={root}", f"out={out}"]


def killed_twice(root: Path, out: Path, count: int) -> list[int]:
    """Run the command, kill and restart it twice; numbers of finished captures at the kills."""
    finished = []
    for share in KILLS:
        run = subprocess.Popen(command(root, out), start_new_session=True,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while len(list(out.rglob(DONE))) < share * count:
            if run.poll() is not None:
                raise InputError(f"the run ended with code {run.returncode} before it was killed")
            time.sleep(0.1)
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        finished.append(len(list(out.rglob(DONE))))
    subprocess.run(command(root, out), check=True, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL)
    return finished


def run(config: Config) -> Result:
    """Write the captures, estimate them twice; compare the tables."""
    scans = sorted(Path(config["scans"]).glob("*.npz"))
    if not scans:
        raise InputError(f"{config['scans']} holds no scans (npz)")
    work = Path(config["work"])
    root, whole, broken = work / "captures", work / "undisturbed", work / "killed"
    make_tree(scans, root, sensor=config["camera_sensor"], seed=config["seed"])
    for out in (whole, broken):
        shutil.rmtree(out, ignore_errors=True)
    began = time.perf_counter()
    subprocess.run(command(root, whole), check=True)
    seconds = time.perf_counter() - began
    finished = killed_twice(root, broken, len(scans))
    same = {name: (whole / name).read_bytes() == (broken / name).read_bytes() for name in TABLES}
    rows = {name: list(csv.DictReader((whole / name).read_text("utf-8-sig").splitlines()))
            for name in TABLES}
    alphas = {}
    for row in rows["captures.csv"]:
        name = f"{row['fabric']}_{row['sample']}_capture_{row['capture']}"
        alphas[Specimen.from_scan_name(name)] = np.log(
            [float(row[f"{role}_alpha_uN_m"]) for role in ROLES])
    found = agreement(alphas)
    print(table(["", "ratio of alpha, median", "largest", "pairs"],
                [[name, one["median"], one["largest"], one["pairs"]]
                 for name, one in found.items()]))
    print(f"{len(rows['captures.csv'])} captures of {len(rows['fabrics.csv'])} fabrics in "
          f"{seconds:.0f} s, {len(rows['failures.csv'])} failures; killed after {finished}: "
          f"tables {'the same' if all(same.values()) else 'DIFFER'}")
    return Result({
        "captures": len(rows["captures.csv"]), "fabrics": len(rows["fabrics.csv"]),
        "failures": len(rows["failures.csv"]), "seconds": seconds, "killed_after": finished,
        "same_tables": same, "ratios": found,
        "captures_with_warnings": sum(bool(row["flags"]) for row in rows["captures.csv"])})
