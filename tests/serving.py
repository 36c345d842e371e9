"""The service as users start it: ``serve.py`` in a process of its own."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx

from drapenet.service.database import ENDED

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "captures" / "twill"
FILES = {file.name: file.read_bytes() for file in sorted(EXAMPLE.iterdir())
         if file.suffix in (".png", ".yaml")}


class Service:
    """``serve.py`` in a new folder, on a free port."""

    def __init__(self, folder: Path, *, queue: int, workers: int):
        self.folder, self.results, self.log = folder, folder / "results", folder / "log.txt"
        self.queue, self.workers = queue, workers
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self) -> None:
        """Start the service and wait until it responds."""
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(ROOT / "serve.py"), f"port={self.port}",
                 f"results={self.results}", f"workers={self.workers}", f"queue={self.queue}",
                 f"queue_each={self.queue}", "upload_seconds=5"],
                cwd=self.folder, stdout=log, stderr=log)
        while True:
            try:
                httpx.get(self.url, timeout=5)
                return
            except httpx.HTTPError:
                time.sleep(0.05)

    def stop(self, how: int = signal.SIGINT) -> None:
        """Send the signal ``how`` and wait for the end of the process."""
        self.process.send_signal(how)
        self.process.wait(timeout=60)


def post(service: Service, density: float) -> httpx.Response:
    """Upload the example capture with the density ``density``, g/m²."""
    return httpx.post(f"{service.url}/estimates", timeout=60,
                      data={"density_g_m2": f"{density}", "name": f"fabric of {density:g} g/m²"},
                      files=[("files", item) for item in FILES.items()])


def get_state(service: Service, identity: str) -> dict:
    """State of an estimate, as returned by the service."""
    return httpx.get(f"{service.url}/estimates/{identity}", timeout=30).json()


def wait_until_ended(service: Service, identity: str) -> dict:
    """Wait for the end of an estimate; its state."""
    while (found := get_state(service, identity))["state"] not in ENDED:
        time.sleep(0.3)
    return found
