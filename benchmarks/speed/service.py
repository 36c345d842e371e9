"""The service under load, after a kill, and with malformed requests.

Starts ``serve.py`` and, in turn: sends many captures at once, each with another density by which
its result is identified, and again where the queue was full; kills the service while estimates are
in progress, and starts it again; sends malformed requests, from noise on the socket to damaged
captures. All answers are checked: results, sentences, seconds, files outside the folder,
tracebacks in the log.
"""

import io
import json
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

from benchmarks.common import ROOT, Config, Result, table
from common.errors import InputError
from drapenet.service.app import EXAMPLE

INTERRUPTED = 8  # uploads before the kill
LONGEST = 10.0  # s, that an answer to a malformed request may take
PATIENCE = 20.0  # s, after which an answer counts as none
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
        """Start it, and wait until it answers; seconds."""
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
        self.process.send_signal(how)
        self.process.wait(timeout=60)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def memory(self) -> float:
        """GiB of the service and its workers, shared pages counted once."""
        total, left = 0, [self.process.pid]
        while left:
            pid = left.pop()
            try:
                rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
                total += int(re.search(r"^Pss:\s+(\d+)", rollup, re.MULTILINE)[1])
                left += map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
            except (OSError, TypeError):  # it has just ended
                continue
        return total / 1024**2


def post(service: Service, density: float) -> httpx.Response:
    """Upload the example as a fabric of ``density``, g/m²."""
    return CLIENT.post(f"{service.url}/estimates", data={"density_g_m2": f"{density}"}, timeout=60,
                      files=[("files", item) for item in FILES.items()])


def state_of(service: Service, identity: str) -> dict:
    """An estimate, as the service answers."""
    return CLIENT.get(f"{service.url}/estimates/{identity}", timeout=30).json()


def ended(service: Service, identity: str) -> dict:
    """An estimate, once it has ended."""
    while (found := state_of(service, identity))["state"] in ("queued", "running"):
        time.sleep(0.3)
    return found


def many_at_once(service: Service, uploads: int) -> dict:
    """Upload all at once, those refused again and again; are all answered, each with its own?"""
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
        found = ended(service, answer.json()["id"])
        return (found["state"] == "done"
                and found["estimate"]["capture"]["density_g_m2"] == density)

    ended(service, post(service, 100.0).json()["id"])  # workers are ready
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


def killed(service: Service) -> dict:
    """Kill the service with some estimates finished and some not, and start it again."""
    identities = [post(service, 300.0 + k).json()["id"] for k in range(INTERRUPTED)]
    ended(service, identities[1])
    before = {one: state_of(service, one)["state"] for one in identities}
    service.stop(signal.SIGKILL)
    seconds = service.start()
    after = {one: state_of(service, one) for one in identities}
    finished = [one for one in identities if before[one] == "done"]
    return {"finished_before": len(finished),
            "of_them_there": sum(after[one]["state"] == "done" for one in finished),
            "others_interrupted_or_finished": sum(
                after[one]["state"] in ("interrupted", "done")
                for one in identities if one not in finished),
            "under_way_before": len(identities) - len(finished),
            "seconds_to_start": round(seconds, 2)}


# Malformed requests: each sends one and returns the status, 0 where the connection was closed.


def noise(service: Service, rng: random.Random) -> int:
    """Bytes that are no HTTP, or the beginning of a request."""
    words = [rng.randbytes(rng.randint(1, 3000)), b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
             b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
             b"GET /" + b"a" * 70000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
             b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
             b"Content-Type: multipart/form-data; boundary=x\r\n\r\nzz\r\n"]
    with socket.create_connection(("127.0.0.1", service.port), timeout=PATIENCE) as connection:
        connection.sendall(rng.choice(words))
        try:
            answer = connection.recv(4096)
        except ConnectionResetError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


def stalled(service: Service, rng: random.Random) -> int:
    """An upload that stops in the middle."""
    head = (b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n--x\r\n")
    with socket.create_connection(("127.0.0.1", service.port), timeout=PATIENCE) as connection:
        connection.sendall(head + rng.randbytes(rng.randint(0, 500)))
        try:
            answer = connection.recv(4096)
        except ConnectionResetError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


def odd_address(service: Service, rng: random.Random) -> int:
    """A method and an address that nobody should ask for."""
    parts = ["..", "%2e%2e", "etc", "passwd", "estimates", "a" * 22, "\u00fc", "%00", "export",
             "jfab", "static", "state.json", "a" * 3000, "%5c..%5c", "openapi.json?x=" + "y" * 500]
    path = "/".join(rng.choices(parts, k=rng.randint(1, 6)))
    method = rng.choice(["GET", "POST", "PUT", "DELETE", "PATCH", "HEAD", "TRACE", "X" * 30])
    return CLIENT.request(method, f"{service.url}/{path}", timeout=PATIENCE).status_code


def odd_form(service: Service, rng: random.Random) -> int:
    """A multipart body that is damaged, cut, or of something else."""
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
    return CLIENT.post(f"{service.url}/estimates", content=bytes(data), timeout=PATIENCE,
                      headers={"content-type": kind}).status_code


def odd_files(service: Service, rng: random.Random) -> int:
    """A capture with damaged files, hostile names, or nonsense in its fields."""
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
        key = rng.choice(["density_g_m2", "rig", "fx", "refine", "name", "warp_direction_deg",
                          "turns_deg"])
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
    answer = CLIENT.post(f"{service.url}/estimates", data=fields, files=sent, timeout=PATIENCE)
    return answer.status_code


KINDS: dict[Callable[[Service, random.Random], int], int] = {
    noise: 6, stalled: 1, odd_address: 5, odd_form: 6, odd_files: 6}
"""What is sent, and how often of all."""


def malformed(service: Service, count: int, seed: int) -> dict:
    """Send malformed requests, a few at a time."""
    weights = list(KINDS.values())
    statuses: Counter[str] = Counter()
    longest, hung = 0.0, 0
    before = {path for path in service.folder.rglob("*") if service.results not in path.parents}
    lock = threading.Lock()

    def one(k: int) -> None:
        nonlocal longest, hung
        rng = random.Random(seed * 100_003 + k)
        send, = rng.choices(list(KINDS), weights)
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
            hung += seconds > LONGEST

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(one, range(count)))
    while any(json.loads(file.read_text())["state"] in ("queued", "running")
              for file in service.results.glob("*/state.json")):
        time.sleep(0.5)
    outcomes = Counter(json.loads(file.read_text())["state"]
                       for file in service.results.glob("*/state.json"))
    unforeseen = sum("please report" in file.read_text()
                     for file in service.results.glob("*/state.json"))
    after = {path for path in service.folder.rglob("*") if service.results not in path.parents}
    return {"requests": count, "answers": dict(sorted(statuses.items())),
            "longest_seconds": round(longest, 2), "longer_than_10_s": hung,
            "tracebacks": service.log.read_text().count("Traceback"),
            "files_outside": len(after - before), "states_of_all_estimates": dict(outcomes),
            "unforeseen_failures": unforeseen,
            "still_answers": CLIENT.get(service.url, timeout=10).status_code == 200}


def run(config: Config) -> Result:
    """Measure, and print the figures."""
    if config["queue"] < INTERRUPTED:
        raise InputError(f"queue={config['queue']} must be at least {INTERRUPTED}")
    report: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Path(folder), queue=config["queue"], workers=config["workers"])
        try:
            for name, measure in (
                ("many_at_once", lambda: many_at_once(service, config["uploads"])),
                ("killed", lambda: killed(service)),
                ("malformed", lambda: malformed(service, config["malformed"], config["seed"])),
            ):
                report[name] = measure()
                print(table([name, ""], [[key, str(value)] for key, value in report[name].items()]),
                      flush=True)
        finally:
            service.stop()
            print(*[line for line in service.log.read_text().splitlines() if "Error" in line][:20],
                  sep="\n")
    return Result(report)
