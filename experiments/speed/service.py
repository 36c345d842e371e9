"""The service under load, after a kill, and with malformed requests.

Starts ``serve.py``, then: uploads many captures at once, each with another density that identifies
its result, and repeats uploads that were refused because the queue was full; kills the service
during estimates and restarts it; sends malformed requests, from random bytes to damaged captures.
Checked are results, response times, files outside the folder and tracebacks in the log.
"""

import io
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx

from common.errors import InputError
from drapenet.service.database import Database
from experiments.result import ROOT, Config, Result

UPLOADS_BEFORE_KILL = 8  # uploads before the kill
MAX_SECONDS = 10.0  # s, longest response time for a malformed request
TIMEOUT = 20.0  # s, timeout of a request
EXAMPLE = ROOT / "examples" / "captures" / "twill"
FILES = {file.name: file.read_bytes() for file in sorted(EXAMPLE.iterdir())
         if file.suffix in (".png", ".yaml")}
CLIENT = httpx.Client(limits=httpx.Limits(max_connections=None))


class Service:
    """``serve.py`` in a new folder, on a free port."""

    def __init__(self, folder: Path, *, queue: int, workers: int):
        self.folder, self.results, self.log = folder, folder / "results", folder / "log.txt"
        self._words = [f"queue={queue}", f"workers={workers}"]
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.start()

    def start(self) -> float:
        """Start the service and wait until it responds; seconds."""
        began = time.monotonic()
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(ROOT / "serve.py"), f"port={self.port}",
                 f"results={self.results}", *self._words],
                cwd=self.folder, stdout=log, stderr=log)
        while True:
            try:
                CLIENT.get(self.url, timeout=5)
                return time.monotonic() - began
            except httpx.HTTPError:
                time.sleep(0.05)

    def stop(self, how: int = signal.SIGINT) -> None:
        """Send the signal ``how`` and wait for the end of the process."""
        self.process.send_signal(how)
        self.process.wait(timeout=60)

    @property
    def url(self) -> str:
        """Base address."""
        return f"http://127.0.0.1:{self.port}"

    def memory(self) -> float:
        """GiB of the service and its workers, shared pages counted once."""
        total, remaining = 0, [self.process.pid]
        while remaining:
            pid = remaining.pop()
            try:
                rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
                total += int(re.search(r"^Pss:\s+(\d+)", rollup, re.MULTILINE)[1])
                children = Path(f"/proc/{pid}/task/{pid}/children").read_text()
                remaining += map(int, children.split())
            except (OSError, TypeError):  # the process has ended
                continue
        return total / 1024**2


def post(service: Service, density: float) -> httpx.Response:
    """Upload the example capture with the density ``density``, g/m²."""
    return CLIENT.post(f"{service.url}/estimates", data={"density_g_m2": f"{density}"}, timeout=60,
                      files=[("files", item) for item in FILES.items()])


def get_state(service: Service, identity: str) -> dict:
    """State of an estimate, as returned by the service."""
    return CLIENT.get(f"{service.url}/estimates/{identity}", timeout=30).json()


def wait_until_ended(service: Service, identity: str) -> dict:
    """Wait for the end of an estimate; its state."""
    while (found := get_state(service, identity))["state"] in ("queued", "running"):
        time.sleep(0.3)
    return found


def many_at_once(service: Service, uploads: int) -> dict:
    """Upload all captures at once, repeat refused uploads; check that each gets its own result."""
    statuses: Counter[int] = Counter()
    peak, stop = [service.memory()], threading.Event()

    def watch() -> None:
        while not stop.wait(0.5):
            peak.append(service.memory())

    def one(k: int) -> bool:
        density = 150.0 + k
        while True:
            answer = post(service, density)
            statuses[answer.status_code] += 1
            if answer.status_code != 429:
                break
            time.sleep(1.0)
        found = wait_until_ended(service, answer.json()["id"])
        return (found["state"] == "done"
                and found["estimate"]["capture"]["density_g_m2"] == density)

    wait_until_ended(service, post(service, 100.0).json()["id"])  # starts the workers
    watcher = threading.Thread(target=watch)
    watcher.start()
    began = time.monotonic()
    with ThreadPoolExecutor(uploads) as pool:
        right = sum(pool.map(one, range(uploads)))
    seconds = time.monotonic() - began
    stop.set()
    watcher.join()
    return {"uploads": uploads, "with_their_own_result": right, "seconds": round(seconds, 1),
            "answers": {str(key): count for key, count in sorted(statuses.items())},
            "peak_memory_GiB": round(max(peak), 2)}


def restart_after_kill(service: Service) -> dict:
    """Kill the service while estimates are in progress, restart it, wait for the others' end."""
    identities = [post(service, 300.0 + k).json()["id"] for k in range(UPLOADS_BEFORE_KILL)]
    wait_until_ended(service, identities[1])
    before = {one: get_state(service, one)["state"] for one in identities}
    service.stop(signal.SIGKILL)
    seconds = service.start()
    finished = [one for one in identities if before[one] == "done"]
    kept = [get_state(service, one)["state"] == "done" for one in finished]
    return {"finished_before": len(finished), "finished_after": sum(kept),
            "under_way_before": len(identities) - len(finished),
            "finished_later": sum(wait_until_ended(service, one)["state"] == "done"
                                  for one in identities if one not in finished),
            "seconds_to_start": round(seconds, 2)}


# Malformed requests: each function sends one; returns its status, 0 if the connection was closed.


def random_bytes(service: Service, rng: random.Random) -> int:
    """Send random bytes or an incomplete or invalid HTTP request."""
    words = [rng.randbytes(rng.randint(1, 3000)), b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
             b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
             b"GET /" + b"a" * 70000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
             b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
             b"Content-Type: multipart/form-data; boundary=x\r\n\r\nzz\r\n",
             b"DELETE /estimates/" + b"a" * 22 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
             b"PATCH /fabrics/" + b"a" * 22 + b" HTTP/1.1\r\nHost: localhost\r\n"
             b"Content-Length: 9\r\nContent-Type: application/json\r\n\r\n{\"name\":"]
    with socket.create_connection(("127.0.0.1", service.port), timeout=TIMEOUT) as connection:
        connection.sendall(rng.choice(words))
        try:
            answer = connection.recv(4096)
        except ConnectionResetError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


def stalled(service: Service, rng: random.Random) -> int:
    """Start an upload and stop sending."""
    head = (b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n--x\r\n")
    with socket.create_connection(("127.0.0.1", service.port), timeout=TIMEOUT) as connection:
        connection.sendall(head + rng.randbytes(rng.randint(0, 500)))
        try:
            answer = connection.recv(4096)
        except ConnectionResetError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


def invalid_address(service: Service, rng: random.Random) -> int:
    """Request an invalid address with a random method."""
    parts = ["..", "%2e%2e", "etc", "passwd", "estimates", "a" * 22, "\u00fc", "%00", "export",
             "jfab", "static", "fabrics", "fabrics?search=%25%27", "state.json", "a" * 3000,
             "%5c..%5c", "openapi.json?x=" + "y" * 500]
    path = "/".join(rng.choices(parts, k=rng.randint(1, 6)))
    method = rng.choice(["GET", "POST", "PUT", "DELETE", "PATCH", "HEAD", "TRACE", "X" * 30])
    return CLIENT.request(method, f"{service.url}/{path}", timeout=TIMEOUT).status_code


def invalid_form(service: Service, rng: random.Random) -> int:
    """Send a multipart body that is damaged, truncated or of another type."""
    body = httpx.Request("POST", service.url, files=[("files", item) for item in FILES.items()])
    data, kind = bytearray(body.read()), body.headers["content-type"]
    what = rng.randrange(5)
    if what == 0:
        data = data[: rng.randrange(len(data))]
    elif what == 1:
        kind = rng.choice(["application/json", "multipart/form-data", "text/plain",
                           "multipart/form-data; boundary=" + "b" * 500])
    elif what == 2:
        data = bytearray(rng.randbytes(rng.randint(0, 5000)))
    elif what == 3:
        data = data.replace(b'name="files"', rng.choice([b'name="', b'name="files[]"', b"",
                                                         b'name="a\0b"']))
    else:
        data = data.replace(b"filename=", rng.choice([b"filename*=utf-8''%ff", b"file=",
                                                      b"filename=\"\r\n"]))
    return CLIENT.post(f"{service.url}/estimates", content=bytes(data), timeout=TIMEOUT,
                      headers={"content-type": kind}).status_code


def invalid_files(service: Service, rng: random.Random) -> int:
    """Upload a capture with damaged files, hostile names or invalid fields."""
    files = dict(FILES)
    name = rng.choice(sorted(files))
    data = bytearray(files.pop(name))
    what = rng.randrange(6)
    if what == 0:
        for _ in range(rng.choice((1, 10, 100))):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif what == 1:
        data = data[: rng.randrange(len(data))]
    elif what == 2:
        name = rng.choice(["../../evil.png", "/tmp/evil.yaml", "C:\\evil.png", "a\0b.png",
                           "evil.py", "", "." * 300 + ".png", "\u202egnp.png"])
    fields = {}
    if what >= 3:
        key = rng.choice(["density_g_m2", "tester", "fx", "refine", "name", "warp_direction_deg",
                          "turns_deg", "fabric", "label", "notes"])
        fields[key] = rng.choice(["nan", "1e999", "-1", "../../etc", "{{7*7}}", "<script>", "yes",
                                  "\0", "9" * 150, "$\\frac{", "="])
    files[name] = bytes(data)
    sent: list = [("files", item) for item in files.items()]
    if what == 5:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for inner, content in files.items():
                archive.writestr("../" * rng.randrange(4) + inner, content)
        packed = bytearray(stream.getvalue())
        for _ in range(rng.randrange(4)):
            packed[rng.randrange(len(packed))] = rng.randrange(256)
        sent = [("files", ("a.zip", bytes(packed)))]
    answer = CLIENT.post(f"{service.url}/estimates", data=fields, files=sent, timeout=TIMEOUT)
    return answer.status_code


REQUESTS: dict[Callable[[Service, random.Random], int], int] = {
    random_bytes: 6, stalled: 1, invalid_address: 5, invalid_form: 6, invalid_files: 6}
"""Malformed requests and their relative frequencies."""


def malformed(service: Service, count: int, seed: int) -> dict:
    """Send malformed requests, eight at a time; check responses, files and log."""
    weights = list(REQUESTS.values())
    statuses: Counter[str] = Counter()
    longest, hung = 0.0, 0
    before = {path for path in service.folder.rglob("*") if service.results not in path.parents}
    lock = threading.Lock()

    def one(k: int) -> None:
        nonlocal longest, hung
        rng = random.Random(seed * 100_003 + k)
        send, = rng.choices(list(REQUESTS), weights)
        began = time.monotonic()
        try:
            status = str(send(service, rng) or "closed")
        except httpx.TimeoutException as error:
            status = type(error).__name__
        except TimeoutError:
            status = "no answer"
        except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
            status = "closed" if isinstance(error, httpx.TransportError) else "not sent"
        seconds = time.monotonic() - began
        with lock:
            statuses[status] += 1
            longest = max(longest, seconds)
            hung += seconds > MAX_SECONDS

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(one, range(count)))
    database = Database(service.results)
    while any(row["state"] in ("queued", "running") for row in database.estimates()):
        time.sleep(0.5)
    outcomes = Counter(row["state"] for row in database.estimates())
    unforeseen = sum("please report" in (row["error"] or "") for row in database.estimates())
    after = {path for path in service.folder.rglob("*") if service.results not in path.parents}
    return {"requests": count, "answers": dict(sorted(statuses.items())),
            "longest_seconds": round(longest, 2), "longer_than_10_s": hung,
            "tracebacks": service.log.read_text().count("Traceback"),
            "files_outside": len(after - before), "states_of_all_estimates": dict(outcomes),
            "unforeseen_failures": unforeseen,
            "still_answers": CLIENT.get(service.url, timeout=10).status_code == 200}


def run(config: Config) -> Result:
    """Run the three tests."""
    if config["queue"] < UPLOADS_BEFORE_KILL:
        raise InputError(f"queue={config['queue']} must be at least {UPLOADS_BEFORE_KILL}")
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Path(folder), queue=config["queue"], workers=config["workers"])
        try:
            report = {"many_at_once": many_at_once(service, config["uploads"]),
                      "killed": restart_after_kill(service),
                      "malformed": malformed(service, config["malformed"], config["seed"])}
        finally:
            service.stop()
            print(*[line for line in service.log.read_text().splitlines() if "Error" in line][:20],
                  sep="\n")
    return Result(report)
