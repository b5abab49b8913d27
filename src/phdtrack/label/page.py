"""The page on which a person marks false detections and births: its addresses, who may use it, and how it is started.

Only the browser on this machine, or a client with the token, may talk to it:

* ``Host`` must be one that the server was started for: a foreign name that leads here (DNS rebinding) is refused.
* What changes anything must come from the page itself: ``Origin``, where sent, must be the server's, and a header is
  required that no form on another site can send.
* With a token, every request must bring it: as ``?token=…`` the first time, then as a cookie that only this server gets.
* Every answer has a content security policy that lets the page load from here and from nowhere else.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import json
import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from phdtrack.errors import InputError
from phdtrack.label.session import Session
from phdtrack.label.store import Label, Mark

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ASKED = "x-phdtrack"
COOKIE = "phdtrack_token"
STATIC = Path(__file__).parent / "static"
# A person's clicks: a lasso around every box of a full frame is far below.
_LONGEST = 4_000_000
_KEPT = {"Cache-Control": "private, max-age=86400, immutable"}


def label_app(session: Session) -> Starlette:
    """The application; `Guard` belongs around it."""

    def values(request: Request) -> list[int]:
        """The numbers of the frame and, where the address has one, of the box."""
        return [int(request.path_params[name]) for name in ("number", "box") if name in request.path_params]

    def still(request: Request, sent: dict[str, Any]) -> Response:
        session.frame(*values(request))
        return Response(session.still(*values(request)), media_type="image/jpeg", headers=_KEPT)

    def place_map(request: Request, sent: dict[str, Any]) -> Response:
        mark: Mark = "birth" if request.path_params["mark"] == "birth" else "false"
        return Response(session.place_map(mark), media_type="image/png")

    def export(request: Request, sent: dict[str, Any]) -> Response:
        name = {"Content-Disposition": 'attachment; filename="labels.csv"'}
        return PlainTextResponse(session.store.csv(), media_type="text/csv", headers=name)

    answers: dict[str, Callable[[Request, dict[str, Any]], Response]] = {
        "/": lambda request, sent: Response((STATIC / "label.html").read_bytes(), media_type="text/html; charset=utf-8"),
        "/api/overview": lambda request, sent: JSONResponse(session.overview()),
        "/api/frame/{number:int}": lambda request, sent: JSONResponse(session.frame(*values(request))),
        "/api/frame/{number:int}/alike/{box:int}": lambda request, sent: JSONResponse(session.alike(*values(request))),
        "/api/suggestions": lambda request, sent: JSONResponse(session.suggestions()),
        "/api/map/{mark:str}.png": place_map,
        "/api/labels.csv": export,
        "/still/{number:int}.jpg": still,
        "/crop/{number:int}/{box:int}.jpg": lambda request, sent: Response(
            session.crop(*values(request)), media_type="image/jpeg", headers=_KEPT
        ),
    }
    change = _answer(lambda request, sent: _changed(session, request, sent))
    return Starlette(
        routes=[
            *(Route(path, _answer(work)) for path, work in answers.items()),
            Route("/api/frame/{number:int}/{what:str}", change, methods=["POST"]),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
    )


def _answer(work: Callable[[Request, dict[str, Any]], Response]) -> Callable[[Request], Any]:
    """``work`` in a thread, with the JSON that was sent; what it cannot use is a 400 with a sentence."""

    async def endpoint(request: Request) -> Response:
        try:
            sent = await _sent(request)
            return await run_in_threadpool(work, request, sent)
        except InputError as error:
            return JSONResponse({"error": str(error)}, 400)

    return endpoint


def _changed(session: Session, request: Request, sent: dict[str, Any]) -> Response:
    """Change the marks of a frame as the page asks; the frame as it is then."""
    number, what = int(request.path_params["number"]), request.path_params["what"]
    store, key = session.store, _text(sent, "key")
    match what:
        case "marks":
            marks = session.checked([_label(item) for item in sent.get("marks", [])])
            store.mark(number, marks, _text(sent, "who"), key)
        case "undo":
            store.undo(number, key)
        case "redo":
            store.redo(number, key)
        case "done":
            store.finish(number, bool(sent.get("done", True)), key)
        case _:
            return JSONResponse({"error": f"nothing is called {what}"}, 404)
    return JSONResponse(session.frame(number) | {"progress": session.overview()["progress"]})


async def _sent(request: Request) -> dict[str, Any]:
    """The JSON object of a request that changes something; {} of one that asks."""
    if request.method != "POST":
        return {}
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST:
            raise InputError(f"expected at most {_LONGEST} bytes")
    try:
        sent = json.loads(body or b"{}")
    except ValueError:
        raise InputError("expected JSON") from None
    if not isinstance(sent, dict):
        raise InputError("expected a JSON object")
    return sent


def _text(sent: dict[str, Any], name: str) -> str:
    value = sent.get(name, "")
    if not isinstance(value, str) or len(value) > 100:
        raise InputError(f"expected a short text as {name}")
    return value


def _label(item: Any) -> Label:
    if not isinstance(item, dict) or type(item.get("frame")) is not int or type(item.get("box")) is not int:
        raise InputError("expected marks as objects with frame, box and mark", cure="Reload the page")
    return Label(item["frame"], item["box"], item.get("mark", ""))


@dataclass(frozen=True, slots=True)
class Guard:
    """ASGI middleware: ``hosts`` are the values of ``Host`` that are answered; ``token`` empty for none."""

    app: ASGIApp
    hosts: frozenset[str]
    token: str = ""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, refuse, and put the headers on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                headers.setdefault("Cache-Control", "no-store")
                if self.token and self._given(request) == self.token:
                    headers.append("Set-Cookie", f"{COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict")
            await send(message)

        refusal = self._refusal(request)
        await (refusal or self.app)(scope, receive, sealed)

    def _refusal(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        if host not in self.hosts:
            return PlainTextResponse(f"this server is not {host!r}\n", 421)
        origin = request.headers.get("origin")
        if origin is not None and origin not in {f"http://{known}" for known in self.hosts}:
            return PlainTextResponse("requests of other sites are refused\n", 403)
        if request.method not in ("GET", "HEAD") and request.headers.get(ASKED) != "1":
            return PlainTextResponse(f"the header {ASKED}: 1 is missing\n", 403)
        if self.token and not hmac.compare_digest(self._given(request).encode(), self.token.encode()):
            return PlainTextResponse("open the address with ?token=… that the terminal shows\n", 401)
        return None

    def _given(self, request: Request) -> str:
        return request.query_params.get("token") or request.cookies.get(COOKIE, "")


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
