"""Who is let in, and what every answer carries."""

import pytest
from page_cases import session
from starlette.testclient import TestClient

from phdtrack.errors import InputError
from phdtrack.label.page import COOKIE, POLICY, Guard, label_app, listen

HOST = "127.0.0.1:8000"


@pytest.fixture
def app(tmp_path):
    return label_app(session(tmp_path / "labels.sqlite", 4))


def client(app, token=""):
    return TestClient(Guard(app, frozenset({HOST}), token), base_url=f"http://{HOST}")


def test_answers_carry_the_policy_and_are_not_stored(app):
    answer = client(app).get("/")
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"] == POLICY
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-store"
    assert "unsafe" not in POLICY
    assert "http" not in POLICY


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1:9999", "localhost.evil.example:8000", ""])
def test_other_names_of_this_server_are_refused(app, host):
    assert client(app).get("/api/overview", headers={"host": host}).status_code == 421


def test_other_sites_change_nothing(app):
    inside = client(app)
    marks = {"marks": [{"frame": 1, "box": 0, "mark": "false"}]}
    assert inside.post("/api/frame/1/marks", json=marks).status_code == 403
    origin = {"origin": "http://evil.example", "x-phdtrack": "1"}
    assert inside.post("/api/frame/1/marks", json=marks, headers=origin).status_code == 403
    assert inside.get("/api/overview", headers={"origin": "null"}).status_code == 403
    assert inside.get("/api/overview").json()["progress"]["false"] == 0
    own = {"origin": f"http://{HOST}", "x-phdtrack": "1"}
    assert inside.post("/api/frame/1/marks", json=marks, headers=own).status_code == 200
    assert inside.get("/api/overview").json()["progress"]["false"] == 1


def test_with_a_token_nobody_enters_without(app):
    outside = client(app, token="secret")
    for path in ("/", "/api/overview", "/still/1.jpg", "/static/label.js"):
        assert outside.get(path).status_code == 401
    assert outside.get("/?token=wrong").status_code == 401
    assert COOKIE not in outside.cookies
    first = outside.get("/?token=secret")
    assert first.status_code == 200
    assert "HttpOnly" in first.headers["set-cookie"]
    assert outside.get("/api/overview").status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/static/../page.py", "/static/%2e%2e/page.py", "/static/..%2f..%2fpyproject.toml", "/still/../../etc/passwd",
        "/static//etc/passwd", "/etc/passwd", "/still/99999.jpg", "/crop/1/777.jpg", "/api/frame/99999",
    ],
)  # fmt: skip
def test_nothing_else_can_be_read(app, path):
    answer = client(app).get(path)
    assert answer.status_code in (400, 404)
    assert b"root:" not in answer.content
    assert b"import" not in answer.content


def test_an_address_beyond_this_machine_needs_a_token():
    for host, needed in (("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)):
        address = listen(host)
        with pytest.raises(InputError, match="cannot listen on"):
            listen(host, address.listening.getsockname()[1])
        address.listening.close()
        assert bool(address.token) is needed
        assert ("token=" in address.url) is needed
