"""Who may use the service: programs on its machine, those who know its password, or everybody."""

from base64 import b64decode
from ipaddress import ip_address
from secrets import compare_digest
from socket import gethostname
from time import monotonic

from fastapi import Request

from common.errors import InputError
from drapenet.config import ServeConfig

CHALLENGE = {"WWW-Authenticate": 'Basic realm="DrapeNet", charset="UTF-8"'}
"""Header of a refusal, at which a browser asks for the password."""
_LEAST = 8  # characters of a password
_ASKED = "this service has a password; give it with any user name"
_GUESSES, _PAUSE = 10, 30.0  # of a client at once, and s until it may guess again
_CLIENTS = 10_000  # that are remembered, the latest


def require_decision(settings: ServeConfig) -> None:
    """InputError if other machines could reach the service although nobody has decided so."""
    length = len(settings.password)
    if settings.password and settings.open:
        raise InputError("open=true is for a service without a password, and there is one; leave "
                         "out open=true, or password= and the variable DRAPENET_PASSWORD")
    if 0 < length < _LEAST:
        raise InputError(f"the password has {length} characters; give at least {_LEAST}")
    if not (settings.password or settings.open or is_loopback(settings.host)):
        raise InputError(f"host={settings.host}: other machines could see and remove all fabrics; "
                         "set the environment variable DRAPENET_PASSWORD to a password, or give "
                         "open=true if everybody who can reach this machine may do so")


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine can reach a service at an address."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:  # the name of a machine
        return False


def is_unspecified(host: str) -> bool:
    """Whether an address, 0.0.0.0 or ::, stands for all of this machine's."""
    try:
        return ip_address(host).is_unspecified
    except ValueError:
        return False


def url_host(host: str) -> str:
    """What the URL of a service at an address has in its place: browsers open no 0.0.0.0 or ::."""
    if is_unspecified(host):
        return "localhost"
    return f"[{host}]" if ":" in host else host


def public_address(settings: ServeConfig) -> str:
    """Address of the service for people, as reports state it."""
    host = (settings.hosts[0] if settings.hosts else
            gethostname() if is_unspecified(settings.host) else url_host(settings.host))
    return settings.address or f"http://{host}:{settings.port}"


class Guard:
    """Asks for a password, and lets each client guess it a few times at once, then now and then."""

    def __init__(self, password: str):
        self._password = password.encode()
        self._forgotten: dict[str, float] = {}  # s, when all wrong ones of a client will be

    def refusal(self, request: Request) -> tuple[int, str] | None:
        """Status and sentence for a request without the password, which may come with any user
        name, or from a client that guesses; None if there is no password."""
        stated = request.headers.get("authorization", "")
        if not self._password or not stated:
            return (401, _ASKED) if self._password else None
        now, client = monotonic(), _place(request.client.host if request.client else "")
        forgotten = max(self._forgotten.get(client, now), now)
        if forgotten - now > (_GUESSES - 1) * _PAUSE:  # also of the right one
            return 429, f"{_GUESSES} wrong passwords came from your address; try again in a minute"
        if compare_digest(_password_in(stated), self._password):
            return None
        self._forgotten.pop(client, None)
        self._forgotten[client] = forgotten + _PAUSE
        if len(self._forgotten) > _CLIENTS:
            del self._forgotten[next(iter(self._forgotten))]
        return 401, _ASKED


def _password_in(stated: str) -> bytes:
    """The password in a header of HTTP Basic; empty if there is none."""
    scheme, _, coded = stated.partition(" ")
    try:
        return b64decode(coded).partition(b":")[2] if scheme.lower() == "basic" else b""
    except ValueError:  # not base64
        return b""


def _place(host: str) -> str:
    """The address of a client, or of its network, of whose addresses in IPv6 it has any number."""
    try:
        address = ip_address(host)
    except ValueError:  # of a test, which has none
        return host
    if address.version == 6 and not address.ipv4_mapped:
        return f"{int(address) >> 64:x}"
    return host
