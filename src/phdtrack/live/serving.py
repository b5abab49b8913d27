"""How the pages are served, and to whom: what `docs/security.md` promises is kept here, number by
number.

Only the browser on this machine, or a client with the token, may talk to a page:

* ``Host`` must be one that the server was started for: a foreign name that leads here (DNS
  rebinding) is refused.
* What changes anything must come from the page itself: ``Origin``, where sent, must be the
  server's, and a header is required that no form on another site can send.
* With a token, every request must bring it: as ``?token=…`` the first time, then as a cookie that
  only this server gets.
* Every answer has a content security policy that lets the page load from here and from nowhere
  else.

Uvicorn and h11 read the requests. Neither limits how long a client may take or how many there are:
that is added here.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import ipaddress
import mimetypes
import re
import secrets
import socket
import ssl
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h11
import uvicorn
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from phdtrack.errors import InputError
from phdtrack.files import json_value

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src"
    " 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ASKED = "x-phdtrack"
COOKIE = "phdtrack_"
# Seconds until a connection is cut that is silent, from the first byte of a request until its
# header is there, from there until its body is there, and until an answer is taken.
SILENT = 15.0
HEADER = 10.0
BODY = 20.0
ANSWER = 40.0
# Connections at once, in all and of one address; bytes of a request's address, header and body.
CONNECTIONS = 128
OF_ADDRESS = 32
MAX_TARGET = 2048
MAX_HEADER = 16384
MAX_BODY = 2**20
# Wrong tokens in so many seconds of one address and of all; then the others in that time are not
# looked at.
GUESSES = 10
ALL_GUESSES = 100
GUESSING = 60.0
_NAME = re.compile(r"([A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?|\[[0-9A-Fa-f:.]+\])(?::\d{1,5})?")
_BUSY = (
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\nConnection: close\r\nContent-Length:"
    b" 0\r\n\r\n"
)
_METHODS = ("GET", "HEAD", "POST")
JSON = "application/json"
Clock = Callable[[], float]
Endpoint = Callable[[Request], Awaitable[Response]]


class Guard:
    """Refuses who may not use the page and requests that are too large, and puts the headers on
    every answer.

    Parameters
    ----------
    app : what answers the others; it gets the whole body at once.
    hosts : the values of ``Host`` that are answered.
    token : that every request must bring, unless it is empty.
    scheme : https where that is spoken.
    clock : seconds, for the limit of guesses.
    """

    def __init__(
        self,
        app: ASGIApp,
        hosts: frozenset[str],
        token: str = "",
        scheme: str = "http",
        clock: Clock = time.monotonic,
    ) -> None:
        self._app = app
        self._hosts = hosts
        self._token = token
        self._scheme = scheme
        # Its name tells servers apart that one browser knows: an old cookie is no wrong guess.
        self._cookie = COOKIE + hashlib.sha256(token.encode()).hexdigest()[:8]
        self._clock = clock
        self._begun = clock()
        self._wrong = Counter[str]()
        self._let_in = set[str]()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        request = Request(scope, receive)
        given = request.query_params.get("token") or request.cookies.get(self._cookie, "")

        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(HEADERS)
                headers.setdefault("Cache-Control", "no-store")
                if (
                    self._token
                    and message["status"] < 400
                    and request.query_params.get("token") == self._token
                ):
                    if self._scheme == "https":
                        secure = "; Secure"
                    else:
                        secure = ""
                    headers.append(
                        "Set-Cookie",
                        f"{self._cookie}={self._token}; HttpOnly; Path=/; SameSite=strict{secure}",
                    )
            await send(message)

        answer = (
            _unusable(request)
            or self._foreign(request)
            or (self._unknown(request, given) if self._token else None)
        )
        if answer is not None:
            await answer(scope, receive, dressed)
            return
        body = bytearray()
        try:
            async for part in request.stream():
                body += part
                if len(body) > MAX_BODY:
                    await _refused(413, f"expected at most {MAX_BODY} bytes")(
                        scope, receive, dressed
                    )
                    return
        except ClientDisconnect:
            return
        whole = iter([{"type": "http.request", "body": bytes(body), "more_body": False}])

        async def once() -> Message:
            return next(whole, None) or await receive()

        await self._app(scope, once, dressed)

    def _foreign(self, request: Request) -> Response | None:
        """What is refused for where it was sent to, and where it comes from."""
        host = request.headers.get("host", "")
        origin = request.headers.get("origin")
        if host.lower() not in self._hosts:
            return _refused(
                421, f"this server is not {host!r}: start it with --allow-host NAME if it is to be"
            )
        if origin is not None and origin.lower() not in {
            f"{self._scheme}://{known}" for known in self._hosts
        }:
            return _refused(403, "requests of other sites are refused")
        if request.method == "POST" and request.headers.get(ASKED) != "1":
            return _refused(403, f"the header {ASKED}: 1 is missing")
        return None

    def _unknown(self, request: Request, given: str) -> Response | None:
        """What is refused for its token."""
        now = self._clock()
        address = _network(request.client.host if request.client else "")
        if now - self._begun >= GUESSING:
            self._begun = now
            self._wrong = Counter()
        many = self._wrong.total() >= ALL_GUESSES and address not in self._let_in
        if given and (many or self._wrong[address] >= GUESSES):
            answer = _refused(429, "too many wrong tokens: try again in a minute")
            answer.headers["Retry-After"] = str(max(1, round(self._begun + GUESSING - now)))
            return answer
        if hmac.compare_digest(given.encode(), self._token.encode()):
            self._let_in.add(address)
            return None
        if given:
            self._wrong[address] += 1
        return _refused(401, "open the address with ?token=… that the terminal shows")


def _unusable(request: Request) -> Response | None:
    """What no page of ours sends."""
    headers = request.scope["headers"]
    target = request.scope.get("raw_path", b"") + b"?" + request.scope["query_string"]
    if request.method not in _METHODS:
        return _refused(405, f"expected {', '.join(_METHODS)}")
    if len(target) > MAX_TARGET:
        return _refused(414, f"expected an address of at most {MAX_TARGET} bytes")
    if sum(len(name) + len(value) + 4 for name, value in headers) > MAX_HEADER:
        return _refused(431, f"expected a header of at most {MAX_HEADER} bytes")
    if b"%" in re.sub(rb"%[0-9A-Fa-f]{2}", b"", target) or not request.scope["path"].isprintable():
        return _refused(400, "expected an address of printable letters, others as %XX")
    names = [name for name, _ in headers]
    if b"transfer-encoding" in names and b"content-length" in names:
        return _refused(400, "expected Content-Length or Transfer-Encoding, got both")
    if int(request.headers.get("content-length", "0")) > MAX_BODY:
        return _refused(413, f"expected at most {MAX_BODY} bytes")
    return None


def _refused(status: int, why: str) -> Response:
    """An answer after which the connection ends: what follows on it is not read."""
    return PlainTextResponse(f"{why}\n", status, {"Connection": "close"})


def _network(address: str) -> str:
    """What counts as one address: of IPv6 the network, in which a machine may take any."""
    if ":" in address:
        return str(ipaddress.ip_network((address.partition("%")[0], 64), strict=False))
    return address


def static(folder: Path) -> list[Route]:
    """Routes to the files in a folder as they are now, below /static."""

    def answering(file: Path) -> Endpoint:
        data = file.read_bytes()
        media = mimetypes.guess_type(file.name)[0]

        async def answer(request: Request) -> Response:
            return Response(data, media_type=media)

        return answer

    return [Route(f"/static/{file.name}", answering(file)) for file in sorted(folder.iterdir())]


def endpoint(
    work: Callable[..., Any],
    media: str = JSON,
    headers: Mapping[str, str] | None = None,
    query: Sequence[str] = (),
) -> Endpoint:
    """What answers with the result of ``work``, which runs in a thread; what it cannot use is a 400
    with a sentence.

    Parameters
    ----------
    work : is given the parameters of the path, those of the ``query``, and as ``sent`` the body of
        a POST.
    media : type of the answer; of `JSON` it is what JSON says of the result.
    headers : of the answer.
    query : names of parameters, empty where the address has none.
    """

    async def answer(request: Request) -> Response:
        given = dict(request.path_params) | {
            name: request.query_params.get(name, "") for name in query
        }
        try:
            if request.method == "POST":
                sent = {"sent": await request.body()}
            else:
                sent = {}
            result = await run_in_threadpool(work, **given, **sent)
        except InputError as error:
            return JSONResponse({"error": str(error)}, 400)
        if media == JSON:
            return JSONResponse(json_value(result))
        return Response(result, 200, headers, media)

    return answer


class Address(NamedTuple):
    """Where a page is: the open socket, the address to open, and the token in it (empty on
    loopback).

    ``hosts`` are the values of ``Host`` by which it may be asked for, ``tls`` is None without
    encryption.
    """

    listening: socket.socket
    url: str
    token: str
    hosts: frozenset[str]
    tls: ssl.SSLContext | None = None


def listen(
    host: str = "127.0.0.1",
    port: int = 0,
    allow: Sequence[str] = (),
    certificate: Path | None = None,
    key: Path | None = None,
    preferred: Sequence[int] = (),
) -> Address:
    """Take a port. The address has a token unless it is loopback under its own names. Raises
    `InputError` where the port cannot be had, or a name or file cannot be used.

    Parameters
    ----------
    host, port : to listen on; with port 0 the first of ``preferred`` that is free, or else any.
    allow : more names or addresses by which a browser may ask for the page.
    certificate, key : files for TLS (PEM); None for none.
    """
    for name in allow:
        if not _NAME.fullmatch(name):
            cure = "Say a name as cam.example.org, or an address as 192.168.1.5 or [fd00::5]."
            raise InputError(
                f"expected a name without http:// and /, got {name!r}",
                where="--allow-host",
                cure=cure,
            )
    tls = _tls(certificate, key)
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
        listening = _bound(host, (port,) if port else (*preferred, 0))
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or error
        raise InputError(
            f"cannot listen on {host}:{port} ({problem})",
            where="--port",
            cure="Choose another port",
        ) from None
    taken = listening.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    if loopback:
        names = {"127.0.0.1", "localhost", "[::1]"}
    else:
        names = {shown, socket.gethostname(), socket.getfqdn()}
    if allow or shown in ("0.0.0.0", "[::]"):
        if allow:
            shown = allow[0]
        else:
            shown = socket.gethostname()
    # What is forwarded from the usual port comes without a number.
    hosts = {*allow, *(f"{name}:{taken}" for name in (*names, *allow))}
    if loopback and not allow:
        token = ""
    else:
        token = secrets.token_urlsafe(16)
    if ":" in shown.rpartition("]")[2]:
        place = shown
    else:
        place = f"{shown}:{taken}"
    url = f"{'https' if tls else 'http'}://{place}/" + (f"?token={token}" if token else "")
    return Address(listening, url, token, frozenset(one.lower() for one in hosts), tls)


def _bound(host: str, ports: Sequence[int]) -> socket.socket:
    """A socket on the first of the ports that is free. Raises `OSError` where none is."""
    if ":" in host:
        family = socket.AF_INET6
    else:
        family = socket.AF_INET
    for port in ports[:-1]:
        with contextlib.suppress(OSError):
            return socket.create_server((host, port), family=family)
    return socket.create_server((host, ports[-1]), family=family)


def _tls(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """TLS 1.2 or later. Raises `InputError` where the files are not a certificate and its key."""
    if certificate is None and key is None:
        return None
    if certificate is None or key is None:
        raise InputError(
            "expected a certificate and its key, got one of them", where="--certificate, --key"
        )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # Without a word OpenSSL would ask for it on the terminal.
        context.load_cert_chain(certificate, key, password=lambda: "")
    except (OSError, ValueError) as error:
        problem = (
            "expected a certificate and its key, not encrypted, as PEM"
            f" ({getattr(error, 'reason', '') or error.args[-1]})"
        )
        cure = (
            "Make a pair: openssl req -x509 -newkey rsa:2048 -nodes -days 365 -keyout key.pem -out"
            " certificate.pem"
        )
        raise InputError(problem, where=f"{certificate}, {key}", cure=cure) from None
    return context


def serve(app: ASGIApp, address: Address) -> None:
    """Answer until Ctrl-C."""
    guarded = Guard(app, address.hosts, address.token, "https" if address.tls else "http")
    config = uvicorn.Config(
        guarded,
        http=_Connection,
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        h11_max_incomplete_event_size=MAX_HEADER,
        # Connections are cut by `_Connection`.
        timeout_keep_alive=int(ANSWER),
        timeout_graceful_shutdown=2,
    )
    listening = _Listening(address.listening)
    # Uvicorn ends in order on Ctrl-C and then raises it again: here it is how one leaves.
    with (
        contextlib.suppress(KeyboardInterrupt),
        asyncio.Runner(loop_factory=partial(_Loop, address.tls)) as runner,
    ):
        runner.run(uvicorn.Server(config).serve(sockets=[listening]))


class _Listening(socket.socket):
    """Accepts no more connections than it may; what TLS has not greeted yet counts, too."""

    def __init__(self, listening: socket.socket) -> None:
        super().__init__(listening.family, listening.type, listening.proto, listening.detach())
        self._open = dict[socket.socket, str]()

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection. Raises `ConnectionAbortedError` where there are too many."""
        connection, address = super().accept()
        self._open = {one: network for one, network in self._open.items() if one.fileno() >= 0}
        network = _network(str(address[0]))
        if (
            len(self._open) < CONNECTIONS
            and sum(one == network for one in self._open.values()) < OF_ADDRESS
        ):
            self._open[connection] = network
            return connection, address
        with contextlib.closing(connection), contextlib.suppress(OSError):
            connection.setblocking(False)
            connection.send(_BUSY)
        raise ConnectionAbortedError("too many connections")


class _Loop(asyncio.SelectorEventLoop):
    """Speaks TLS, where there is any, with those who greet in time."""

    def __init__(self, tls: ssl.SSLContext | None) -> None:
        super().__init__()
        if tls:
            self._more = {
                "ssl": tls,
                "ssl_handshake_timeout": HEADER,
                "ssl_shutdown_timeout": HEADER,
            }
        else:
            self._more = {}

    async def create_server(self, *given: Any, **named: Any) -> Any:
        """As asyncio's."""
        return await super().create_server(*given, **(named | self._more))


class _Connection(H11Protocol):
    """A connection that is cut when it takes too long."""

    _cut: asyncio.TimerHandle | None = None
    _awaited: object = None
    _heard = False
    _since = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        self._heard = True
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        self._heard = False
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        if self._cut is not None:
            self._cut.cancel()

    def send_400_response(self, msg: str) -> None:
        # The application may be about to answer, and must not any more; where it has begun no other
        # answer can be given.
        if self.cycle is not None:
            self.cycle.disconnected = True
        try:
            super().send_400_response(msg)
        except h11.LocalProtocolError:
            self.transport.abort()

    def _watch(self) -> None:
        """Begin to count where something else is awaited than before."""
        awaited = (self.conn.their_state, self.cycle, self._heard)
        if awaited == self._awaited:
            return
        if self._cut is not None:
            self._cut.cancel()
        waiting = HEADER if self._heard else SILENT
        seconds = {h11.IDLE: waiting, h11.SEND_BODY: BODY}.get(self.conn.their_state, ANSWER)
        self._awaited = awaited
        self._since = self.loop.time()
        self._cut = self.loop.call_later(seconds, self._late)

    def _late(self) -> None:
        # Who is still taking the answer has time for it.
        if self.transport.get_write_buffer_size() and self.loop.time() < self._since + ANSWER:
            self._cut = self.loop.call_later(1.0, self._late)
        else:
            self.transport.abort()
