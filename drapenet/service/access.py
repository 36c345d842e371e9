"""Who may use the service: programs on its machine, those who know its password, or everybody."""

from base64 import b64decode
from ipaddress import ip_address
from secrets import compare_digest
from socket import gethostname

from fastapi import Request

from common.errors import InputError
from drapenet.config import ServeConfig

CHALLENGE = {"WWW-Authenticate": 'Basic realm="DrapeNet", charset="UTF-8"'}
"""Header of a refusal, at which a browser asks for the password."""
_LEAST = 8  # characters of a password


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


def is_admitted(request: Request, password: str) -> bool:
    """Whether a request states the password, with any user name, or there is none."""
    scheme, _, coded = request.headers.get("authorization", "").partition(" ")
    try:
        stated = b64decode(coded).partition(b":")[2] if scheme.lower() == "basic" else b""
    except ValueError:  # not base64
        stated = b""
    return not password or compare_digest(stated, password.encode())
