"""Who may talk to the page: the browser on this machine, or who knows the token.

* ``Host`` must be one that the server was started for: a name of somebody else's that leads here (DNS rebinding) is refused.
* What changes anything must come from the page itself: ``Origin``, where sent, must be the server's, and a header is asked
  for that no form on another site can send.
* With a token, every request must bring it: as ``?token=…`` the first time, then as a cookie that only this server gets.
* Everything is answered with a content security policy that lets the page load from here and from nowhere else.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
