"""Who may use the service: what it asks of whoever runs it, and of its clients."""

import base64
from socket import gethostname
from types import SimpleNamespace

import pytest
from fastapi.testclient import TestClient
from services import BreakablePool, settings_for

import drapenet.service.access
import drapenet.service.app
from common.errors import InputError
from drapenet.service.access import Guard
from drapenet.service.app import create_app, serve

PASSWORD = "Öl: 8 Rollen"
ADDRESSES = ("/", "/docs", "/openapi.json", "/static/app.js", "/manual/service.md",
             "/examples/twill.zip", "/fabrics", "/fabrics.zip", "/fabrics/x", "/estimates/x",
             "/estimates/x/report.pdf", "/estimates/x/export/jfab", "/nothing")


@pytest.fixture
def served(monkeypatch, capsys):
    """A function of a host's words that starts and ends a service there; the line it prints."""
    class Server:
        def __init__(self, config: object) -> None:
            self.config = SimpleNamespace(bind_socket=lambda: SimpleNamespace(
                getsockname=lambda: ("", 8123)))

        def run(self, **options: object) -> None:
            """Nothing: the service ends at once."""

    monkeypatch.setattr(drapenet.service.app.uvicorn, "Server", Server)

    def start(folder, *words: str) -> str:
        serve(settings_for(folder, *words))
        return capsys.readouterr().out

    return start


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "fe80::1", "lab.example.org"])
def test_a_host_that_others_can_reach_needs_a_decision(host, served, tmp_path, monkeypatch):
    monkeypatch.delenv("DRAPENET_PASSWORD", raising=False)
    with pytest.raises(InputError, match=f"^host={host}: .* DRAPENET_PASSWORD .* open=true"):
        served(tmp_path, f"host={host}")
    assert served(tmp_path, f"host={host}", "open=true")
    assert served(tmp_path, f"host={host}", f"password={PASSWORD}")
    monkeypatch.setenv("DRAPENET_PASSWORD", PASSWORD)
    assert served(tmp_path, f"host={host}")
    with pytest.raises(InputError, match="open=true is for a service without a password"):
        served(tmp_path, f"host={host}", "open=true")


@pytest.mark.parametrize(("host", "address", "words"), [
    *((host, host, []) for host in ("127.0.0.1", "127.1.2.3", "localhost")), ("::1", "[::1]", []),
    *((host, "localhost", ["open=true"]) for host in ("::", "0.0.0.0", "0::0")),
    ("[::1]", "[::1]", []), ("fe80::1", "[fe80::1]", ["open=true"])])
def test_the_printed_address_can_be_opened(host, address, words, served, tmp_path):
    """That of this machine needs no decision."""
    printed = served(tmp_path, f"host={host}", *words)
    assert printed.startswith(f"http://{address}:8123 ")
    assert (f"from other machines http://{gethostname()}:8123;" in printed) == (
        host in ("::", "0.0.0.0", "0::0"))


def test_an_address_of_ipv6_is_a_host_of_requests(tmp_path, monkeypatch):
    monkeypatch.setattr("drapenet.service.pools.ProcessPool", BreakablePool)
    app = create_app(settings_for(tmp_path, "host=fd00::7", "open=true"))
    with TestClient(app, base_url="http://[fd00::7]:8000") as client:
        assert client.get("/fabrics").status_code == 200


def test_an_address_of_another_machine_is_refused_with_the_reason(tmp_path):
    with pytest.raises(InputError, match=r"host=192\.0\.2\.7 with port=0 \(.*\); choose"):
        serve(settings_for(tmp_path, "host=192.0.2.7", "port=0", "open=true"))


def test_a_short_password_is_refused_without_being_printed(served, tmp_path):
    with pytest.raises(InputError, match=r"^the password has 7 characters; give at least 8$"):
        served(tmp_path, "password=secret7")


@pytest.fixture
def client(tmp_path, monkeypatch):
    monkeypatch.setattr("drapenet.service.pools.ProcessPool", BreakablePool)
    app = create_app(settings_for(tmp_path, "host=0.0.0.0", f"password={PASSWORD}"))
    with TestClient(app, base_url="http://localhost") as client:
        yield client


def stating(text: bytes, scheme: str = "Basic") -> dict[str, str]:
    return {"authorization": f"{scheme} {base64.b64encode(text).decode()}"}


def test_every_address_asks_for_the_password(client):
    right = stating(f"anybody:{PASSWORD}".encode())
    for method, address in (*(("GET", one) for one in ADDRESSES), ("POST", "/estimates"),
                            ("PATCH", "/fabrics/x"), ("DELETE", "/fabrics/x"),
                            ("DELETE", "/estimates/x")):
        answer = client.request(method, address)
        assert answer.status_code == 401, address
        assert answer.headers["www-authenticate"].startswith("Basic "), address
        assert "password" in answer.json()["error"]
        assert client.request(method, address, headers=right).status_code != 401, address


@pytest.mark.parametrize("headers", [
    stating(f"x:{PASSWORD} ".encode()), stating(b"x:"), stating(PASSWORD.encode()), stating(b""),
    stating(f"x:{PASSWORD}".encode(), "Bearer"), {"authorization": "Basic"},
    {"authorization": "Basic é"}, {"authorization": "Basic a"}, {"authorization": ""}])
def test_other_credentials_are_refused(client, headers):
    raw = {name: value.encode("latin-1") for name, value in headers.items()}
    assert client.get("/fabrics", headers=raw).status_code == 401


def test_wrong_passwords_of_an_address_are_counted(client, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(drapenet.service.access, "monotonic", lambda: now[0])
    right, wrong = (stating(f"x:{text}".encode()) for text in (PASSWORD, "wrong guess"))

    def statuses(*headers: dict[str, str]) -> list[int]:
        return [client.get("/fabrics", headers=stated).status_code for stated in headers]

    assert statuses(*[{}] * 20, right) == [401] * 20 + [200]  # browsers ask first
    assert statuses(*[wrong] * 12, right) == [401] * 10 + [429] * 3
    answer = client.get("/fabrics", headers=right)
    assert "wrong passwords" in answer.json()["error"] and answer.headers["retry-after"] == "30"
    now[0] += 31
    assert statuses(right, right, wrong, right) == [200, 200, 401, 429]
    now[0] += 3600
    assert statuses(*[wrong] * 12) == [401] * 10 + [429] * 2


def test_guesses_are_counted_by_network_and_of_a_bounded_number_of_clients(monkeypatch):
    monkeypatch.setattr(drapenet.service.access, "_CLIENTS", 50)
    guard = Guard(PASSWORD)

    def status(host: str, password: str = "wrong guess") -> int | None:
        refusal = guard.refusal(SimpleNamespace(client=SimpleNamespace(host=host),
                                                headers=stating(f"x:{password}".encode())))
        return refusal and refusal[0]

    assert [status(f"fd00::{k:x}") for k in range(11)] == [401] * 10 + [429]
    assert status("fd00:0:0:1::1", PASSWORD) is None
    assert [status(f"::ffff:192.0.2.{k}") for k in range(20)] == [401] * 20
    assert status("fd00::9", PASSWORD) == 429
    assert [status(f"198.51.100.{k}") for k in range(100)] == [401] * 100
    assert status("fd00::9", PASSWORD) is None and len(guard._forgotten) == 50
