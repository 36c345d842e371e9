"""An estimate from a cold start: processor time, memory and modules of a process of ``infer.py``.

Each command runs alone, after a first run that compiles and fills the system's cache, as often as
``runs`` says; the least time is reported, because other processes may interfere.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from experiments.report import ROOT, Report
from experiments.study import PlainKeys, Study

EXAMPLES = ROOT / "examples" / "captures"
COMMANDS = {
    "photograph": [f"capture={EXAMPLES / 'twill_photograph'}", "drapes=0"],
    "depth views": [f"capture={EXAMPLES / 'twill'}", "drapes=0"],
    "photograph, two drapes and report": [f"capture={EXAMPLES / 'twill_photograph'}"],
    "depth views, two drapes and report": [f"capture={EXAMPLES / 'twill'}"],
}
TARGETS = {"photograph": 1.5, "depth views": 2.0, "photograph, two drapes and report": 5.5}
"""CPU-seconds."""
ENVIRONMENT = {name: value for name, value in os.environ.items()
               if name != "PYTHONDONTWRITEBYTECODE"}  # else each run may compile all sources


class Keys(PlainKeys):
    runs: int = 3  # of each command, beside a first one


def measured(words: list[str]) -> dict[str, float]:
    """CPU time, s, and largest resident memory, MB, of an estimate."""
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [sys.executable, "infer.py", *words, f"out={Path(folder) / 'out'}"], cwd=ROOT,
            env=ENVIRONMENT, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"infer.py {' '.join(words)} ended with the status {status}")
    return {"cpu_seconds": usage.ru_utime + usage.ru_stime, "memory_mb": usage.ru_maxrss / 1024}


def run(keys: Keys) -> Report:
    """Time all commands."""
    found = {}
    for name, words in COMMANDS.items():
        measured(words)
        runs = [measured(words) for _ in range(keys.runs)]
        found[name] = {key: round(min(one[key] for one in runs), 2) for key in runs[0]}
    return {"targets_cpu_seconds": TARGETS, "commands": found}


STUDY = Study(Keys, run)
