"""Estimation of a folder of raw frames by one command, with and without interruptions.

Simulated drapes of known fabrics are placed in synthetic scenes (:mod:`data.render.scenes`), two
scenes each, and written as raw frames, FABRIC/SAMPLE/CAPTURE. ``infer.py captures=`` estimates them
once without interruption and once killed and restarted twice; both must give the same tables.
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

from common.errors import InputError
from data.captures.writer import write_capture
from data.render.rays import QUARTERS
from data.render.scenes import CLUTTER, raw_scene
from drapenet.batch.batch import DONE
from experiments.drapes import drape_as_planned, plan_specimen
from experiments.result import ROOT, Config, Result
from sim.material import REFERENCE_DENSITY
from sim.rig import DISC_RIG

SCENES = 2  # of each drape
KILLS = (0.2, 0.6)  # shares of the captures that are finished when the run is killed
TABLES = ("fabrics.csv", "captures.csv", "failures.csv")


def make_tree(root: Path, *, fabrics: int, edge_mm: float, sensor: str, seed: int) -> None:
    """Write raw frames of drapes of ``fabrics`` fabrics; existing fabrics are kept."""
    for number in tqdm(range(fabrics), desc="frames", mininterval=10):
        folder = root / f"fabric_{number}" / "sample_1"
        if (folder / str(SCENES)).exists():
            continue
        shape = drape_as_planned(plan_specimen(number, rig=DISC_RIG, nuisances="real", seed=seed),
                                 edge=1e-3 * edge_mm)
        for capture in range(1, SCENES + 1):
            rng = np.random.default_rng([seed, number, capture])
            turns = np.array(QUARTERS) + np.radians(rng.uniform(-3, 3, len(QUARTERS)))
            scene = raw_scene(shape.positions, shape.faces, rng, rig=DISC_RIG,
                              turns=turns - turns[0], sensor=sensor,
                              clutter=str(rng.choice(list(CLUTTER))))
            write_capture(folder / str(capture), views=scene.frames,
                          intrinsics=scene.camera.intrinsics, density=REFERENCE_DENSITY,
                          rig=DISC_RIG, depth_unit=1e-4)


def command(root: Path, out: Path) -> list[str]:
    """Command line that estimates the captures in ``root``."""
    return [sys.executable, str(ROOT / "infer.py"), f"captures={root}", f"out={out}"]


def killed_twice(root: Path, out: Path, count: int) -> list[int]:
    """Run the command, kill and restart it twice; numbers of finished captures at the kills."""
    finished = []
    for share in KILLS:
        run = subprocess.Popen(command(root, out), start_new_session=True,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while len(list(out.rglob(f"{DONE}.json"))) < share * count:
            if run.poll() is not None:
                raise InputError(f"the run ended with code {run.returncode} before it was killed")
            time.sleep(0.1)
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        finished.append(len(list(out.rglob(f"{DONE}.json"))))
    subprocess.run(command(root, out), check=True, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL)
    return finished


def run(config: Config) -> Result:
    """Write the captures, estimate them twice, and compare the tables."""
    work = Path(config["work"])
    root, whole, broken = work / "captures", work / "undisturbed", work / "killed"
    make_tree(root, fabrics=config["fabrics"], edge_mm=config["edge_mm"],
              sensor=config["camera_sensor"], seed=config["seed"])
    for out in (whole, broken):
        shutil.rmtree(out, ignore_errors=True)
    began = time.perf_counter()
    subprocess.run(command(root, whole), check=True)
    seconds = time.perf_counter() - began
    finished = killed_twice(root, broken, SCENES * config["fabrics"])
    same = {name: (whole / name).read_bytes() == (broken / name).read_bytes() for name in TABLES}
    rows = {name: list(csv.DictReader((whole / name).read_text("utf-8-sig").splitlines()))
            for name in TABLES}
    return Result({
        "captures": len(rows["captures.csv"]), "fabrics": len(rows["fabrics.csv"]),
        "failures": len(rows["failures.csv"]), "seconds": seconds, "killed_after": finished,
        "same_tables": same,
        "captures_with_warnings": sum(bool(row["flags"]) for row in rows["captures.csv"])})
