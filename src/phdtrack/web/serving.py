"""A page on a port: `listen` takes the port and names the address, `serve` answers until Ctrl-C."""

from __future__ import annotations

import contextlib
import logging
import re
import secrets
import socket
import ssl
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import uvicorn
from starlette.types import ASGIApp

from phdtrack.errors import InputError
from phdtrack.web.guard import guarded

CONNECTIONS = 128
"""Connections at once; uvicorn answers more with 503."""
_LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")
_ANY_ADDRESS = ("0.0.0.0", "[::]")
# A name or address, and perhaps a port.
_NAME = re.compile(
    r"(?P<name>[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?|\[[0-9A-Fa-f:.]+\])(?P<port>:\d{1,5})?"
)


class Address(NamedTuple):
    """The address of a page.

    Attributes
    ----------
    listening : the open socket.
    url : the address to open, with the token.
    token : that every request must bring; empty on loopback.
    hosts : names that are answered, without ports.
    certificate, key : files for TLS; None without encryption.
    """

    listening: socket.socket
    url: str
    token: str
    hosts: tuple[str, ...]
    certificate: Path | None = None
    key: Path | None = None


def listen(
    host: str = "127.0.0.1",
    port: int = 0,
    allow: Sequence[str] = (),
    certificate: Path | None = None,
    key: Path | None = None,
    preferred: Sequence[int] = (),
) -> Address:
    """Take a port. The address has a token, except on loopback without further names.

    Parameters
    ----------
    host, port : to listen on; with port 0 the first of ``preferred`` that is free, or else any.
    allow : more names or addresses by which a browser may ask for the page, also with a port.
    certificate, key : files for TLS (PEM); None for none.
    preferred : ports to try before any other.

    Raises
    ------
    InputError : the port cannot be had, or a name or file cannot be used.
    """
    allowed = [_parsed(name) for name in allow]
    _check_certificate(certificate, key)
    listening = _socket_on(host, (port,) if port else (*preferred, 0))
    shown = f"[{host}]" if ":" in host else host
    loopback = shown in _LOOPBACK_NAMES
    names: tuple[str, ...] = _LOOPBACK_NAMES
    if not loopback:
        names = (shown, socket.gethostname(), socket.getfqdn())
    if allow:
        shown = allow[0]
    elif shown in _ANY_ADDRESS:
        shown = socket.gethostname()
    if not (allowed and allowed[0]["port"]):
        shown += f":{listening.getsockname()[1]}"
    token = "" if loopback and not allow else secrets.token_urlsafe(16)
    scheme = "https" if certificate else "http"
    url = f"{scheme}://{shown}/" + (f"?token={token}" if token else "")
    hosts = (*names, *(match["name"] for match in allowed))
    return Address(listening, url, token, hosts, certificate, key)


def serve(app: ASGIApp, address: Address) -> None:
    """Answer until Ctrl-C; requests under way have two seconds to end."""
    config = uvicorn.Config(
        guarded(app, address.hosts, address.token),
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        limit_concurrency=CONNECTIONS,
        timeout_graceful_shutdown=2,
        ssl_certfile=address.certificate,
        ssl_keyfile=address.key,
    )
    server = uvicorn.Server(config)
    log = logging.getLogger("uvicorn.error")

    def before_the_end(record: logging.LogRecord) -> bool:
        return not server.should_exit

    # A request that is cut off at the end is no error to report.
    log.addFilter(before_the_end)
    try:
        # Uvicorn ends in order on Ctrl-C and then raises it again.
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[address.listening])
    finally:
        log.removeFilter(before_the_end)


def _parsed(name: str) -> re.Match[str]:
    """A name that is allowed, in parts. Raises `InputError` if it is none."""
    match = _NAME.fullmatch(name)
    if match is None:
        cure = "Give a name as cam.example.org, or an address as 192.168.1.5 or [fd00::5]."
        problem = f"expected a name without http:// and /, got {name!r}"
        raise InputError(problem, where="--allow-host", cure=cure)
    return match


def _socket_on(host: str, ports: Sequence[int]) -> socket.socket:
    """A socket on the first of the ports that is free. Raises `InputError` if none is."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in ports[:-1]:
        with contextlib.suppress(OSError):
            return socket.create_server((host, port), family=family)
    try:
        return socket.create_server((host, ports[-1]), family=family)
    except (OSError, OverflowError) as error:
        problem = f"cannot listen on {host}:{ports[-1]} ({getattr(error, 'strerror', error)})"
        raise InputError(problem, where="--port", cure="Choose another port") from None


def _check_certificate(certificate: Path | None, key: Path | None) -> None:
    """Raise `InputError` unless there is neither, or a certificate and its key."""
    if certificate is None and key is None:
        return
    if certificate is None or key is None:
        problem = "expected a certificate and its key, got one of them"
        raise InputError(problem, where="--certificate, --key")
    try:
        # Without a password OpenSSL would ask for it on the terminal.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, lambda: "")
    except (OSError, ValueError) as error:
        reason = getattr(error, "reason", "") or error.args[-1]
        problem = f"expected a certificate and its key, not encrypted, as PEM ({reason})"
        cure = (
            "Make a pair: openssl req -x509 -newkey rsa:2048 -nodes -days 365 -keyout key.pem -out"
            " certificate.pem"
        )
        raise InputError(problem, where=f"{certificate}, {key}", cure=cure) from None
