"""Many uploads at once, malformed requests and a kill: nothing is lost, and nothing is a fault."""

import random
import signal
import socket
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from serving import Service, get_state, post, wait_until_ended

from drapenet.network.checkpoint import BUNDLED

pytestmark = [pytest.mark.slow,
              pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")]
REQUESTS = [b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
            b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
            b"GET /" + b"a" * 70000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
            b"POST /estimates HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
            b"Content-Type: multipart/form-data; boundary=x\r\n\r\nzz\r\n",
            b"GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n"]


@pytest.fixture
def service(tmp_path):
    service = Service(tmp_path, queue=32, workers=1)
    yield service
    service.stop()


def sent(service: Service, data: bytes) -> int:
    """Send bytes; the status, 0 if the connection is closed without one."""
    with socket.create_connection(("127.0.0.1", service.port), timeout=20) as connection:
        try:
            connection.sendall(data)
            connection.shutdown(socket.SHUT_WR)
            answer = connection.recv(4096)
        except ConnectionError:
            return 0
    return int(answer.split()[1]) if answer.startswith(b"HTTP/") else 0


def test_uploads_at_once_have_their_own_results_although_the_service_is_killed(service):
    densities = [150.0 + k for k in range(3)]
    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(lambda density: post(service, density), densities))
    identities = [answer.json()["id"] for answer in answers]
    while not any(get_state(service, one)["state"] == "running" for one in identities):
        time.sleep(0.1)
    service.stop(signal.SIGKILL)
    service.start()
    for identity, density in zip(identities, densities, strict=True):
        estimate = wait_until_ended(service, identity)["estimate"]
        alpha, reference = (estimate[part]["warp"]["alpha_uN_m"]["median"]
                            for part in ("moduli", "moduli_at_300_g_m2"))
        assert alpha / reference == pytest.approx(density / 300, rel=1e-3)


def test_malformed_requests_are_answered_and_leave_no_traceback(service):
    before = set(service.folder.iterdir())
    rng = random.Random(0)
    noise = [rng.randbytes(rng.randint(1, 3000)) for _ in range(40)]
    with ThreadPoolExecutor(8) as pool:
        statuses = list(pool.map(lambda data: sent(service, data), REQUESTS * 8 + noise))
    assert set(statuses) <= {0, *range(400, 500)}
    assert httpx.get(service.url, timeout=10).status_code == 200
    assert "Traceback" not in service.log.read_text()
    assert set(service.folder.iterdir()) == before
