"""Start a page: on loopback with a port of its own, or, when told to, on the network with a token."""

from __future__ import annotations

import contextlib
import ipaddress
import secrets
import socket
from dataclasses import dataclass

import uvicorn
from starlette.types import ASGIApp

from phdtrack.errors import InputError
from phdtrack.label.guard import Guard


@dataclass(frozen=True, slots=True)
class Address:
    """Where a page is: the open socket, the address to open, and the token in it (empty on loopback)."""

    listening: socket.socket
    url: str
    token: str
    hosts: frozenset[str]


def listen(host: str = "127.0.0.1", port: int = 0) -> Address:
    """Take ``port``, or any that is free with 0. Raises `InputError` where it cannot be had."""
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
        listening = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on {host}:{port} ({problem})", where="--port", cure="Choose another port") from None
    taken = listening.getsockname()[1]
    names = {"127.0.0.1", "localhost", "[::1]"} if loopback else {host, socket.gethostname(), socket.getfqdn()}
    token = "" if loopback else secrets.token_urlsafe(16)
    shown = f"[{host}]" if ":" in host else host
    url = f"http://{shown}:{taken}/" + (f"?token={token}" if token else "")
    return Address(listening, url, token, frozenset(f"{name}:{taken}" for name in names))


def serve(app: ASGIApp, address: Address) -> None:
    """Answer until Ctrl-C."""
    guarded = Guard(app, address.hosts, address.token)
    config = uvicorn.Config(guarded, log_level="warning", lifespan="off", server_header=False, timeout_graceful_shutdown=2)
    # Uvicorn ends in order on Ctrl-C and then raises it again: here it is how one leaves.
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[address.listening])
