"""Who may use a page, and the headers of every answer."""

from __future__ import annotations

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from phdtrack.web.guard import COOKIE, HEALTH, POLICY, guarded

HOST = "127.0.0.1:8000"


async def hello(request: Request) -> PlainTextResponse:
    return PlainTextResponse("hello")


def client(token: str = "", base_url: str = f"http://{HOST}") -> TestClient:
    app = Starlette(routes=[Route("/", hello, methods=["GET", "POST"])])
    hosts = ("127.0.0.1", "localhost", "[::1]", "Cam.example.org")
    return TestClient(guarded(app, hosts, token), base_url=base_url)


def test_answers_carry_the_policy_and_are_not_stored() -> None:
    answer = client().get("/")
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"] == POLICY
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-store"
    assert "unsafe" not in POLICY
    assert "http" not in POLICY


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example:8000", "", "a:b"])
def test_other_names_of_the_server_are_refused(host: str) -> None:
    assert client().get("/", headers={"host": host}).status_code == 400


@pytest.mark.parametrize("host", ["localhost", "[::1]:8000", "cam.example.org:90"])
def test_own_names_are_answered(host: str) -> None:
    assert client().get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", f"http://{HOST}0", ""])
def test_requests_of_other_sites_are_refused(origin: str) -> None:
    own = {"x-phdtrack": "1"}
    assert client().get("/", headers={"origin": origin}).status_code == 403
    assert client().post("/", headers=own | {"origin": origin}).status_code == 403


def test_a_change_needs_a_header_that_forms_cannot_send() -> None:
    origin = {"origin": f"http://{HOST}"}
    assert client().post("/", headers=origin).status_code == 403
    assert client().post("/", headers=origin | {"x-phdtrack": "1"}).status_code == 200


@pytest.mark.parametrize(
    ("path", "asking", "status"),
    [
        (HEALTH, "127.0.0.1", 200),
        (HEALTH, "::1", 200),
        (HEALTH, "192.168.1.7", 401),
        (HEALTH, "testclient", 401),
        ("/", "127.0.0.1", 401),
        (f"{HEALTH}/../", "127.0.0.1", 401),
    ],
)
def test_only_health_checks_of_this_machine_need_no_token(
    path: str, asking: str, status: int
) -> None:
    app = Starlette(routes=[Route("/", hello), Route(HEALTH, hello)])
    page = TestClient(
        guarded(app, ("127.0.0.1",), "secret"), base_url=f"http://{HOST}", client=(asking, 5000)
    )
    assert page.get(path).status_code == status


def test_with_a_token_nobody_enters_without() -> None:
    page = client("secret")
    assert page.get("/").status_code == 401
    assert page.get("/?token=wrong").status_code == 401
    assert page.get("/?token=%ff").status_code == 401
    assert not page.cookies
    first = page.get("/?token=secret")
    assert first.status_code == 200
    words = set(first.headers["set-cookie"].split("; ")[1:])
    assert words == {"HttpOnly", "Path=/", "SameSite=strict"}
    assert page.get("/").status_code == 200
    # Another server on the same host has a cookie of another name.
    other = client("another")
    other.cookies = page.cookies
    assert other.get("/").status_code == 401


def test_over_tls_the_cookie_is_secure() -> None:
    answer = client("secret", f"https://{HOST}").get("/?token=secret")
    assert answer.headers["set-cookie"].startswith(COOKIE)
    assert answer.headers["set-cookie"].endswith("; Secure")
