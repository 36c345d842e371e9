"""Use the installed project on every Python that it supports: ``make matrix``.

    nox -f tools/matrix.py [-p 3.11]

For each interpreter that there is, an environment is made with the wheel and its pinned
dependencies, without those of ``drapenet[train]``, and deleted after the session; the wheel is used
as in wheel_trial.py.
"""

import os
import shutil
import sys
from pathlib import Path

import nox

sys.path.insert(0, str(Path(__file__).parent))
from wheel_trial import IMPORT, built_wheel, modules, trial

nox.options.error_on_missing_interpreters = False
nox.options.envdir = "outputs/matrix"
os.environ.pop("PYTHONPATH", None)


@nox.session(python=["3.10", "3.11", "3.12", "3.13"])
def installed(session: nox.Session) -> None:
    """The wheel, its modules and commands, and a trial of it."""
    place, scripts = Path(session.create_tmp()).resolve(), Path(session.bin).resolve()
    shutil.rmtree(place)
    place.mkdir()
    try:
        source, wheel = built_wheel(place)
        session.install("--constraint", source / "constraints.txt", wheel)
        session.chdir(place)
        session.run("python", "-I", "-c", IMPORT, *modules(wheel))
        for script in sorted(scripts.glob("drapenet-*")):
            if script.name.removeprefix("drapenet-") not in ("evaluate", "generate", "inspect"):
                session.run(script, "--help", silent=True)
        for step in trial(scripts, source / "examples" / "captures", place / "trial"):
            session.log(step)
    finally:
        shutil.rmtree(scripts.parent)
