"""Use the project as it is installed, from an empty folder: ``make test-wheel``.

The wheel is built from git's index, must hold all that belongs to it, and is installed into an
environment that has the other packages of this one, but neither the checkout nor the packages of
``drapenet[train]``. There its modules are imported, also as if the system were not POSIX, a drape
is simulated, a bundled capture is estimated and refined, and another is uploaded to the service. A
part of an estimate that is left out with a warning is a fault.
"""

import json
import os
import re
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import httpx

from common.interrupt import TRAINING

ROOT = Path(__file__).resolve().parents[1]
LEFT = (".ci", "benchmarks", "docs", "examples", "experiments", "tests", "tools")
"""Folders that are not of the wheel."""
REPORT = ("estimate.json", "report.png", "report.html", "report.pdf", "drape.glb", "torque.svg")
COARSE = ("starts=1", "coarse_mm=12", "edge_mm=12")
"""Keys of ``refine`` for the least number of simulations, which are coarse."""
SECONDS = 300.0  # s, longest time of an estimate, with a service's start
OF_TRAINING = re.compile(
    r"common\.graph_export|data\.(dataset\..*|captures\.off_axis_network|pictures\.cloth_network"
    r"|render\.(scenes|sensors))|drapenet\.network\.(captures|dataset|evaluate|expected_network"
    r"|mixture|model|optimizer|training|weights)|sim\.(batched\..*|sensitivity\.adjoint)")
"""Modules that may import packages of ``drapenet[train]``."""
POSIX = ("fcntl", "grp", "pwd", "resource", "termios")
HIDE = """import importlib.abc, sys
class Hidden(importlib.abc.MetaPathFinder):
    names = set({names!r})
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
"""
IMPORT = HIDE.format(names=POSIX) + """
import importlib
for name in sys.argv[1:]:
    file = importlib.import_module(name).__file__
    assert file.startswith(sys.prefix), f"{name} is not of the wheel: {file}" """
ENVIRONMENT = {**{name: value for name, value in os.environ.items()
                  if name not in ("PYTHONPATH", "DRAPENET_PASSWORD")}, "PYTHONNOUSERSITE": "1"}


class TrialError(Exception):
    """What is wrong with the wheel."""


def run(*words: str | Path, cwd: Path) -> str:
    """Run a command; its output, or a TrialError with it if the command fails."""
    done = subprocess.run(words, cwd=cwd, env=ENVIRONMENT, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    if done.returncode:
        command = " ".join(map(str, words[:8]))
        raise TrialError(f"{done.stdout}\nexit code {done.returncode}: {command}")
    return done.stdout


def built_wheel(folder: Path) -> tuple[Path, Path]:
    """The tree of git's index and its wheel, in ``folder``; TrialError unless it has all files of
    the tree but those of :data:`LEFT`, and no others."""
    source = folder / "source"
    run("git", "checkout-index", "--all", f"--prefix={source}/", cwd=ROOT)
    parts = [part for part in source.iterdir() if part.suffix == ".py" or (
        part.is_dir() and part.name not in LEFT)]  # before the build adds folders
    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "-q", "-w", folder, source, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-m", "check_wheel_contents", "--no-config", "--select=W101,W102",
        *(f"--package={part}" for part in parts), wheel, cwd=folder)
    return source, wheel


def modules(wheel: Path) -> list[str]:
    """Dotted names of the modules of a wheel that need no package of ``drapenet[train]``."""
    parts = [Path(name).with_suffix("").parts for name in zipfile.ZipFile(wheel).namelist()
             if name.endswith(".py")]
    names = (".".join(each[:-1] if each[-1] == "__init__" else each) for each in parts)
    return [name for name in names if not OF_TRAINING.fullmatch(name)]


def borrowing(environment: Path, wheel: Path) -> Path:
    """Python of a new environment with the wheel, which borrows the other packages of this one but
    those of ``drapenet[train]``."""
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=environment.parent)
    python = environment / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", wheel,
        cwd=environment.parent)
    own, = environment.glob("lib/python*/site-packages")
    # Path files in a borrowed folder are not read: the checkout's, if editable, is not found.
    (own / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    (own / "sitecustomize.py").write_text(HIDE.format(names=TRAINING), encoding="utf-8")
    return python


def trial(scripts: Path, captures: Path, folder: Path) -> Iterator[str]:
    """Use the installed ``scripts`` in a new ``folder``; yield the name of each use."""
    folder.mkdir()
    run(scripts / "drapenet-sim", "alpha=60,40,30", "edge_mm=12", "out=drape", cwd=folder)
    if (status := _content(folder / "drape" / "drape.json")["status"]) != "converged":
        raise TrialError(f"the status of the drape is {status}")
    yield "drape"
    run(scripts / "drapenet-infer", f"capture={captures / 'twill'}", "refine=simulation",
        *(f"refine.{word}" for word in COARSE), "export=jfab", "out=estimate", cwd=folder)
    files = [file.name for file in (folder / "estimate").iterdir()]
    require_whole(_content(folder / "estimate" / "estimate.json"), files, refined=True)
    if "fabric.jfab" not in files:
        raise TrialError("there is no file for another tool")
    yield "estimate, refined"
    refused = subprocess.run([scripts / "drapenet-train"], cwd=folder, env=ENVIRONMENT, text=True,
                             stderr=subprocess.PIPE)
    if (refused.returncode, refused.stderr.count("\n")) != (2, 1) or (
            "pip install 'drapenet[train]'" not in refused.stderr):
        raise TrialError(f"drapenet-train does not say what to install: {refused.stderr}")
    yield "a training refused"
    serve(scripts, captures / "twill_photograph", folder)
    yield "service"


def require_whole(
    estimate: Mapping[str, object], files: Collection[str], *, refined: bool
) -> None:
    """TrialError if a part of an ``estimate`` is missing, although the command has ended well."""
    parts = ("resimulation", *(["refined"] * refined))
    if missing := [*(part for part in parts if not estimate.get(part)),
                   *(name for name in REPORT if name not in files)]:
        raise TrialError(f"the estimate lacks {', '.join(missing)}; its warnings: "
                         f"{[found['text'] for found in estimate['warnings']] or 'none'}")


def serve(scripts: Path, capture: Path, folder: Path) -> None:
    """Start the service, upload a capture, wait for its result, save all, and end the service."""
    log = folder / "log.txt"
    with log.open("w") as output:
        process = subprocess.Popen([scripts / "drapenet-serve", "port=0", "workers=1"], cwd=folder,
                                   env=ENVIRONMENT, stdout=output, stderr=output)
    try:
        upload(process, log, capture)
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            raise TrialError("the service does not end after Ctrl-C") from None
    if "Traceback" in log.read_text():
        raise TrialError(f"the service's log:\n{log.read_text()}")


def upload(process: subprocess.Popen, log: Path, capture: Path) -> None:
    """Upload a capture to a service that starts, and wait for its result."""
    deadline = time.monotonic() + SECONDS
    while not (printed := re.search(r"http://\S+", log.read_text())) or not _answers(printed[0]):
        if process.poll() is not None or time.monotonic() > deadline:
            raise TrialError(f"the service does not start:\n{log.read_text()}")
        time.sleep(0.1)
    client = httpx.Client(base_url=printed[0], timeout=30)
    files = [("files", (file.name, file.read_bytes())) for file in sorted(capture.iterdir())
             if file.name in ("capture.yaml", "outline.jpg")]
    begun = client.post("/estimates", files=files).raise_for_status().json()
    while (found := client.get(begun["url"]).raise_for_status().json())["state"] in (
            "queued", "running"):
        if time.monotonic() > deadline:
            raise TrialError(f"no result in {SECONDS:g} s; the service's log:\n{log.read_text()}")
        time.sleep(0.2)
    if found["state"] != "done":
        raise TrialError(f"the upload is {found['state']}: {found['error']}\n{log.read_text()}")
    require_whole(found["estimate"], found["files"], refined=False)
    for address in ("/", "/docs", "/static/app.js", f"{begun['url']}/export/jfab", "/fabrics.zip"):
        client.get(address).raise_for_status()


def _answers(address: str) -> bool:
    try:
        return httpx.get(address).is_success
    except httpx.TransportError:
        return False


def _content(file: Path) -> dict:
    return json.loads(file.read_text(encoding="utf-8"))


def main() -> int:
    """Print each step with the time since the start, s; 1 after a fault, which is printed."""
    start = time.monotonic()

    def say(step: str) -> None:
        print(f"{time.monotonic() - start:5.0f} s  {step}", flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            source, wheel = built_wheel(folder)
            say("wheel")
            python = borrowing(folder / "environment", wheel)
            run(python, "-I", "-c", IMPORT, *modules(wheel), cwd=folder)
            say(f"{len(modules(wheel))} modules")
            for step in trial(python.parent, source / "examples" / "captures", folder / "trial"):
                say(step)
        except TrialError as error:
            print(error)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
