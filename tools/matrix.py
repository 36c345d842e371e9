"""Run the installed project on every Python that it supports: ``make matrix``.

    python tools/matrix.py [PYTHON ...]  # names or paths of interpreters, else python3.10 to 3.13

For each interpreter, an environment is created with the wheel and its pinned dependencies; then
every module is imported, every command is run with --help, the wheel is used as in wheel_trial.py,
and fast tests are run, all outside the source tree. An environment takes 9 GB and is deleted before
the next is created. Missing interpreters are listed as absent.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from wheel_trial import IMPORT, TrialError, built_wheel, modules, run, trial

PYTHONS = [f"python3.{minor}" for minor in range(10, 14)]
TESTS = ["apps/test_cantilever_command.py", "common/test_documents.py", "common/test_files.py",
         "data/test_bad_captures.py", "data/test_cameras.py", "data/test_captures.py",
         "data/test_fabrics.py", "data/test_prior.py", "drapenet/test_checkpoint.py",
         "drapenet/test_posterior.py", "sim/test_energies.py", "sim/test_material.py",
         "sim/test_newton.py"]


def steps(python: Path, wheel: Path, source: Path, place: Path) -> Iterator[tuple[str, str]]:
    """Run the steps; yield the name and the last line of output of each."""
    environment, elsewhere = place / "environment", place / "elsewhere"
    elsewhere.mkdir(parents=True)
    own, scripts = environment / "bin" / "python", environment / "bin"

    def done(step: str, *words: str | Path) -> tuple[str, str]:
        return step, run(*words, cwd=elsewhere).strip().rpartition("\n")[2]

    yield done("environment", python, "-m", "venv", environment)
    yield done("wheel", own, "-m", "pip", "install", "-qq", "--constraint",
               source / "constraints.txt", wheel, "pytest", "hypothesis", "httpx")
    yield done("modules", own, "-I", "-c", IMPORT, *modules(wheel))
    for script in sorted(scripts.glob("drapenet-*")):
        yield done(f"{script.name} --help", script, "--help")
    for step in trial(scripts, source / "examples" / "captures", place / "trial"):
        yield step, ""
    for folder in ("tests", "examples"):
        shutil.copytree(source / folder, elsewhere / folder)
    yield done("tests", own, "-m", "pytest", "-q", "-W", "ignore", "-m",
               "not slow and not slurm and not browser", *(f"tests/{test}" for test in TESTS))


def interpreter(name: str) -> Path | None:
    """Path of an interpreter, also of pyenv, whose shims may refer to missing versions."""
    pyenv = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser()
    for path in filter(None, [shutil.which(name), *pyenv.glob(f"versions/*/bin/{name}")]):
        if subprocess.run([path, "--version"], capture_output=True).returncode == 0:
            return Path(path)
    return None


def outcome(name: str, wheel: Path, source: Path, place: Path) -> str:
    """Run and print the steps of an interpreter; "passed", "FAILED" or "absent"."""
    if not (python := interpreter(name)):
        return "absent"
    start = time.monotonic()
    print(run(python, "--version", cwd=place.parent).strip(), flush=True)
    try:
        for step, said in steps(python, wheel, source, place):
            print(f"  {time.monotonic() - start:5.0f} s  {step}"
                  + (f": {said}" if step == "tests" else ""), flush=True)
    except TrialError as error:
        print(error, flush=True)
        return "FAILED"
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return "passed"


def main(pythons: Sequence[str]) -> int:
    """Print the outcome for each of ``pythons``; 1 if one failed or all are absent."""
    with tempfile.TemporaryDirectory() as folder:
        source, wheel = built_wheel(Path(folder))
        found = {python: outcome(python, wheel, source, Path(folder) / f"on_{number}")
                 for number, python in enumerate(pythons)}
    print("\n".join(f"{python}: {word}" for python, word in found.items()))
    return int("FAILED" in found.values() or "passed" not in found.values())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or PYTHONS))
