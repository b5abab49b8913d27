"""Middleware that decides who may use a page; `docs/security.md` states what it defends.

* ``Host`` must be a name that the server was started for, so that a foreign name that leads here
  (DNS rebinding) is refused.
* ``Origin``, if it is sent, must be the server's own, and a request that changes something must
  carry a header that no form on another site can send.
* With a token, every request must bring it: as ``?token=…`` the first time, then as a cookie. Only
  a health check of the same machine needs none.
* Every answer has a content security policy that lets the page load from this server only.

Slow and malformed requests are left to uvicorn, and to the reverse proxy of an exposed server.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
from collections.abc import Sequence
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
OWN_HEADER = "x-phdtrack"
"""The header of requests that change something; a form cannot send it."""
COOKIE = "phdtrack_"
"""The beginning of the cookie's name."""
HEALTH = "/healthz"
"""The path of the health check, which a container runs inside."""


def guarded(app: ASGIApp, hosts: Sequence[str], token: str = "") -> ASGIApp:
    """The application behind all checks.

    Parameters
    ----------
    app : the application.
    hosts : names that are answered, without ports.
    token : that every request must bring, unless it is empty.
    """
    return TrustedHostMiddleware(_Guard(app, token), hosts, www_redirect=False)


class _Guard:
    """Checks origin and token, and adds the headers to every answer."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token
        # Cookies are shared by all ports of a host: the name tells its servers apart.
        self._cookie = COOKIE + hashlib.sha256(token.encode()).hexdigest()[:8]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        request = Request(scope)
        refusal = self._refusal(request)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(HEADERS)
                headers.setdefault("Cache-Control", "no-store")
                if refusal is None and "token" in request.query_params:
                    headers.append("Set-Cookie", self._new_cookie(request))
            await send(message)

        await (refusal or self._app)(scope, receive, send_with_headers)

    def _refusal(self, request: Request) -> Response | None:
        """The answer to a request that is refused; None for all others."""
        origin = request.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != request.headers["host"]:
            return _refused(403, "requests of other sites are refused")
        if request.method == "POST" and request.headers.get(OWN_HEADER) != "1":
            return _refused(403, f"the header {OWN_HEADER}: 1 is missing")
        if request.url.path == HEALTH and request.client and _loopback(request.client.host):
            return None
        token = request.query_params.get("token") or request.cookies.get(self._cookie, "")
        if self._token and not hmac.compare_digest(token.encode(), self._token.encode()):
            return _refused(401, "open the address with ?token=… that the terminal shows")
        return None

    def _new_cookie(self, request: Request) -> str:
        """The cookie that carries the token from now on."""
        secure = "; Secure" if request.url.scheme == "https" else ""
        return f"{self._cookie}={self._token}; HttpOnly; Path=/; SameSite=strict{secure}"


def _loopback(address: str) -> bool:
    """True for an address of this machine; False also if it is no address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def _refused(status: int, reason: str) -> Response:
    """An answer that says why."""
    return PlainTextResponse(f"{reason}\n", status)
