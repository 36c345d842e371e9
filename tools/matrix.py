"""Use the installed project on every Python that it supports: ``make matrix``.

    nox -f tools/matrix.py [-p 3.11]

For each interpreter that there is, an environment is made with the wheel and its pinned
dependencies, and deleted after the session, as it takes 9 GB; every module is imported, every
command is run with --help, the wheel is used as in wheel_trial.py, and fast tests are run, all
outside the source tree.
"""

import os
import shutil
import sys
from pathlib import Path

import nox

sys.path.insert(0, str(Path(__file__).parent))
from wheel_trial import IMPORT, built_wheel, modules, trial

TESTS = ["apps/test_cantilever_command.py", "common/test_documents.py", "common/test_files.py",
         "data/test_bad_captures.py", "data/test_cameras.py", "data/test_captures.py",
         "data/test_fabrics.py", "data/test_prior.py", "drapenet/test_checkpoint.py",
         "drapenet/test_posterior.py", "sim/test_energies.py", "sim/test_material.py",
         "sim/test_newton.py"]
nox.options.error_on_missing_interpreters = False
nox.options.envdir = "outputs/matrix"


os.environ.pop("PYTHONPATH", None)


@nox.session(python=["3.10", "3.11", "3.12", "3.13"])
def installed(session: nox.Session) -> None:
    """The wheel, its modules and commands, a trial of it, and tests."""
    place, scripts = Path(session.create_tmp()).resolve(), Path(session.bin).resolve()
    shutil.rmtree(place)
    place.mkdir()
    try:
        source, wheel = built_wheel(place)
        session.install("--constraint", source / "constraints.txt", wheel, "pytest", "hypothesis",
                        "httpx")
        session.chdir(place)
        session.run("python", "-I", "-c", IMPORT, *modules(wheel))
        for script in sorted(scripts.glob("drapenet-*")):
            session.run(script, "--help", silent=True)
        for step in trial(scripts, source / "examples" / "captures", place / "trial"):
            session.log(step)
        for folder in ("tests", "examples"):
            shutil.copytree(source / folder, place / folder)
        session.run("python", "-m", "pytest", "-q", "-W", "ignore", "-m",
                    "not slow and not slurm and not browser", *(f"tests/{test}" for test in TESTS))
    finally:
        shutil.rmtree(scripts.parent)
