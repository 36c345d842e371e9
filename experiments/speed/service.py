"""The service: its speed, many uploads at once, kills, and malformed requests.

Starts ``serve.py``, then: times the first result of an upload and the comparison of four fabrics;
uploads many captures at once, each with another density that identifies its result, and repeats
uploads that were refused because the queue was full; kills the service during estimates, restarts
it and compares fabrics and results with those before; sends malformed requests, from random bytes
to damaged captures. Checked are results, response times, files outside the folder and tracebacks in
the log.
"""

import io
import logging
import os
import random
import re
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import httpx

from common.errors import InputError
from drapenet.service.database import DONE, ENDED, Database
from experiments.result import ROOT, Config, Result

COMPARED = 4  # fabrics
UPLOADS_BEFORE_KILL = 8  # uploads before the first kill
KILLS = 2  # estimates that three services were ended during are given up
MAX_SECONDS = 10.0  # s, longest response time for a malformed request
UPLOAD_SECONDS = 5.0  # s, of the service, after which it ends an upload
TIMEOUT = 20.0  # s, timeout of a request
EXAMPLE = ROOT / "examples" / "captures" / "twill"
FILES = {file.name: file.read_bytes() for file in sorted(EXAMPLE.iterdir())
         if file.suffix in (".png", ".yaml")}
NUMBERS = {"capture.yaml": b"tester: disc300_support180\ndensity_g_m2: 200\n"
                           b"known: {drape_coefficient_percent: 55, nodes: 7}\n"}
"""A capture without pictures, whose estimate takes little time."""
logging.getLogger("httpx").setLevel(logging.WARNING)  # else it reports every request
CLIENT = httpx.Client(limits=httpx.Limits(max_connections=None))


class Service:
    """``serve.py`` in a new folder, on a free port."""

    def __init__(self, folder: Path, *, queue: int, workers: int):
        self.folder, self.results, self.log = folder, folder / "results", folder / "log.txt"
        self.queue, self.workers = queue, workers
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
                 f"results={self.results}", f"workers={self.workers}", f"queue={self.queue}",
                 f"queue_each={self.queue}", f"upload_seconds={UPLOAD_SECONDS}"],
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

    def processes(self) -> list[Path]:
        """Folders in /proc of the service and its workers."""
        found, remaining = [], [self.process.pid]
        while remaining:
            found.append(Path(f"/proc/{remaining.pop()}"))
            for children in _texts(found[-1].glob("task/*"), "children"):
                remaining += map(int, children.split())
        return found

    def memory(self) -> float:
        """GiB of the service and its workers, shared pages counted once."""
        return sum(int(re.search(r"^Pss:\s+(\d+)", text, re.MULTILINE)[1])
                   for text in _texts(self.processes(), "smaps_rollup")) / 1024**2

    def cpu_seconds(self) -> float:
        """CPU seconds of the service and its workers since their start."""
        ticks = [text.rpartition(") ")[2].split()[11:13]  # in user mode, in the system
                 for text in _texts(self.processes(), "stat")]
        return sum(int(number) for pair in ticks for number in pair) / os.sysconf("SC_CLK_TCK")


def _texts(folders: Iterable[Path], name: str) -> list[str]:
    """Content of a file in folders in /proc of processes or threads, but of those that ended."""
    texts = []
    for folder in folders:
        with suppress(OSError):
            texts.append((folder / name).read_text())
    return [text for text in texts if text]


def post(service: Service, density: float) -> httpx.Response:
    """Upload the example capture with the density ``density``, g/m²."""
    return CLIENT.post(f"{service.url}/estimates", timeout=60,
                       data={"density_g_m2": f"{density}", "name": f"fabric of {density:g} g/m²"},
                       files=[("files", item) for item in FILES.items()])


def get_state(service: Service, identity: str) -> dict:
    """State of an estimate, as returned by the service."""
    return CLIENT.get(f"{service.url}/estimates/{identity}", timeout=30).json()


def wait_until_ended(service: Service, identity: str) -> dict:
    """Wait for the end of an estimate; its state."""
    while (found := get_state(service, identity))["state"] not in ENDED:
        time.sleep(0.3)
    return found


def timed(service: Service, action: Callable[[], object]) -> dict[str, float]:
    """Seconds that an action takes, and CPU seconds of the service meanwhile."""
    began, used = time.monotonic(), service.cpu_seconds()
    action()
    return {"seconds": time.monotonic() - began, "cpu_seconds": service.cpu_seconds() - used}


def medians(times: Sequence[dict[str, float]]) -> dict[str, float]:
    """Number, medians and longest of times."""
    return {"times": len(times), "longest": round(max(one["seconds"] for one in times), 2)} | {
        key: round(statistics.median(one[key] for one in times), 2) for key in times[0]}


def speed(service: Service, uploads: int) -> dict:
    """Time the first result of uploads to the idle service, one after the other, and what the page
    requests for a comparison of four fabrics: their estimates and drapes."""
    wait_until_ended(service, post(service, 100.0).json()["id"])  # starts the workers
    first, identities = [], []

    def see(density: float) -> None:
        identities.append(post(service, density).json()["id"])
        while not get_state(service, identities[-1])["estimate"]:
            time.sleep(0.1)

    for k in range(uploads):
        first.append(timed(service, partial(see, 101.0 + k)))
        wait_until_ended(service, identities[-1])
    addresses = [f"{service.url}/estimates/{identity}{file}" for identity in identities[-COMPARED:]
                 for file in ("", "/drape.glb")]
    with ThreadPoolExecutor(len(addresses)) as pool:
        compared = [timed(service, lambda: [answer.raise_for_status() for answer in pool.map(
            CLIENT.get, addresses)]) for _ in range(uploads)]
    return {"first_result": medians(first), "comparison": medians(compared)}


def is_right(found: dict, density: float) -> bool:
    """Whether a result is that of the example with the density ``density``: moduli of one drape
    are proportional to it."""
    if found["state"] != DONE or found["estimate"]["capture"]["density_g_m2"] != density:
        return False
    alpha, reference = (found["estimate"][part]["warp"]["alpha_uN_m"]["median"]
                        for part in ("moduli", "moduli_at_300_g_m2"))
    return abs(alpha / reference / (density / 300.0) - 1.0) < 1e-3


def many_at_once(service: Service, uploads: int) -> dict:
    """Upload all captures at once, repeat refused uploads; check that each gets its own result."""
    statuses: Counter[int] = Counter()
    peak, stop = [service.memory()], threading.Event()

    def watch() -> None:
        while not stop.wait(1.0):
            peak.append(service.memory())

    def one(k: int) -> bool:
        density = 150.0 + k
        while True:
            answer = post(service, density)
            statuses[answer.status_code] += 1
            if answer.status_code != 429:
                break
            time.sleep(5.0)
        return is_right(wait_until_ended(service, answer.json()["id"]), density)

    right = []

    def upload_all() -> None:
        with ThreadPoolExecutor(uploads) as pool:
            right.extend(pool.map(one, range(uploads)))

    watcher = threading.Thread(target=watch)
    watcher.start()
    times = timed(service, upload_all)
    stop.set()
    watcher.join()
    return {"uploads": uploads, "with_their_own_result": sum(right),
            **{key: round(value, 1) for key, value in times.items()},
            "answers": {str(key): count for key, count in sorted(statuses.items())},
            "peak_memory_GiB": round(max(peak), 2)}


def stored(service: Service) -> tuple[dict, dict]:
    """All fabrics, by identity, and all results with their files."""
    fabrics = {one["id"]: (one["name"], one["notes"]) for one in CLIENT.get(
        f"{service.url}/fabrics", params={"count": 200}, timeout=30).json()["fabrics"]}
    database = Database(service.results)
    rows = [database.estimate(one["id"]) for one in database.estimates() if one["state"] == DONE]
    return fabrics, {row["id"]: (row["estimate"], {
        file.name: file.read_bytes() for file in (service.results / row["id"]).iterdir()
        if file.is_file()}) for row in rows}


def lost(before: dict, after: dict) -> int:
    """Number of entries of ``before`` that are missing or different ``after``."""
    return sum(after.get(key) != value for key, value in before.items())


def restart_after_kill(service: Service) -> dict:
    """Kill the service twice while estimates are in progress; what is lost, and what ends later."""
    densities = {post(service, 300.0 + k).json()["id"]: 300.0 + k
                 for k in range(UPLOADS_BEFORE_KILL)}
    wait_until_ended(service, next(iter(densities)))
    losses, starts, under_way, left = Counter(), [], [], 0
    for _ in range(KILLS):
        while not any(get_state(service, one)["state"] == "running" for one in densities):
            time.sleep(0.1)
        fabrics, results = stored(service)
        under_way.append(sum(one not in results for one in densities))
        processes = service.processes()
        service.stop(signal.SIGKILL)
        starts.append(service.start())
        left += sum(text.rpartition(") ")[2][0] != "Z" for text in _texts(processes, "stat"))
        now = stored(service)
        losses.update(fabrics=lost(fabrics, now[0]), results=lost(results, now[1]))
    return {"kills": KILLS, "fabrics": len(fabrics), "results": len(results),
            "lost_fabrics": losses["fabrics"], "lost_results": losses["results"],
            "under_way": under_way, "processes_left": left,
            "finished_later": sum(is_right(wait_until_ended(service, one), density)
                                  for one, density in densities.items() if one not in results),
            "seconds_to_start": round(max(starts), 2)}


# Malformed requests: each function sends one; returns its status, 0 if the connection was closed.


def status_of(service: Service, data: bytes, *, ends: bool) -> int:
    """Send bytes, after which the client ``ends`` or waits without a word."""
    with socket.create_connection(("127.0.0.1", service.port), timeout=TIMEOUT) as connection:
        connection.sendall(data)
        try:
            if ends:
                connection.shutdown(socket.SHUT_WR)
            answer = connection.recv(4096)
        except ConnectionError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


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
    return status_of(service, rng.choice(words), ends=True)


def stalled(service: Service, rng: random.Random) -> int:
    """Start an upload and stop sending."""
    head = (b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\n--x\r\nContent-Disposition: "
            b"form-data; name=\"files\"; filename=\"view_0.png\"\r\n\r\n")
    return status_of(service, head + rng.randbytes(rng.randint(0, 500)), ends=False)


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
    what = rng.randrange(6)
    files = dict(NUMBERS if what in (3, 4) and rng.randrange(2) else FILES)
    name = rng.choice(sorted(files))
    data = bytearray(files.pop(name))
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
    service.stop()
    service.queue = count  # none is refused unread
    service.start()
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
    """Run the four tests."""
    for key, least in (("queue", UPLOADS_BEFORE_KILL), ("repeats", COMPARED)):
        if config[key] < least:
            raise InputError(f"{key}={config[key]} must be at least {least}")
    with tempfile.TemporaryDirectory() as folder:
        service = Service(Path(folder), queue=config["queue"], workers=config["workers"])
        try:
            report = {**speed(service, config["repeats"]),
                      "many_at_once": many_at_once(service, config["uploads"]),
                      "killed": restart_after_kill(service),
                      "malformed": malformed(service, config["malformed"], config["seed"])}
        finally:
            service.stop()
            print(*[line for line in service.log.read_text().splitlines() if "Error" in line][:20],
                  sep="\n")
    return Result(report)
