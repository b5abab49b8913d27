"""What docs/security.md promises, number by number, of a server as it is started: raw sockets on
loopback.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from phdtrack.errors import InputError
from phdtrack.live import serving
from phdtrack.live.serving import Guard, listen

ROOT = Path(__file__).resolve().parents[2]
LABELLING = ROOT / "tests" / "label"
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
PROGRAM = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from page_cases import session
from phdtrack.label.label_page import label_app
from phdtrack.live import serving
scale, host, folder = float(sys.argv[3]), sys.argv[4], Path(sys.argv[2])
for name in ("SILENT", "HEADER", "BODY", "ANSWER"):
    setattr(serving, name, scale * getattr(serving, name))
tls = [folder / "certificate.pem", folder / "key.pem"] if host == "tls" else [None, None]
allow = [] if host == "127.0.0.1" else ["cam.example.org"]
address = serving.listen("127.0.0.1", 0, allow, *tls)
print(address.url, flush=True)
serving.serve(label_app(session(folder / "labels.sqlite", 12)), address)
"""


@contextlib.contextmanager
def started(folder: Path, scale: float = 1.0, host: str = "127.0.0.1") -> Iterator[tuple[str, int]]:
    """Address and port of a page; it wrote nothing on its terminal but the address."""
    words = [sys.executable, "-c", PROGRAM, str(LABELLING), str(folder), str(scale), host]
    with (folder / "stderr").open("wb") as stderr:
        child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=stderr, text=True)
        try:
            assert child.stdout is not None
            url = child.stdout.readline().strip()
            yield url, int(re.search(r":(\d+)/", url)[1])
        finally:
            child.terminate()
            child.wait(20)
            child.stdout.close()
    assert (folder / "stderr").read_text() == ""


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=90)


def answered(port: int, sent: bytes) -> bytes:
    """What comes back until the server ends the connection; what is cut says nothing."""
    with connect(port) as one, contextlib.suppress(ConnectionResetError, BrokenPipeError):
        one.sendall(sent)
        got = bytearray()
        while part := one.recv(65536):
            got += part
        return bytes(got)
    return b""


def request(port: int, first: str = "GET / HTTP/1.1", *more: str, body: bytes = b"") -> bytes:
    lines = [first, f"Host: 127.0.0.1:{port}", "Connection: close", *more]
    return "\r\n".join([*lines, "", ""]).encode() + body


def status(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1]) if answer else 0


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    with started(tmp_path_factory.mktemp("page")) as (_, port):
        yield port


def post(port: int, body: bytes, *more: str, path: str = "/api/frame/1/marks") -> bytes:
    return request(
        port,
        f"POST {path} HTTP/1.1",
        "X-Phdtrack: 1",
        *(more or (f"Content-Length: {len(body)}",)),
        body=body,
    )


def test_the_page_names_every_number() -> None:
    numbers = {
        "SILENT": "15 s", "HEADER": "10 s", "BODY": "20 s", "ANSWER": "40 s", "CONNECTIONS": "128 connections",
        "OF_ADDRESS": "32 of one address", "MAX_TARGET": "2048 bytes", "MAX_HEADER": "16 KiB", "MAX_BODY": "1 MiB",
        "GUESSES": "10 wrong tokens", "ALL_GUESSES": "100 in all", "GUESSING": "a minute",
    }  # fmt: skip
    scale = {"KiB": 1024, "MiB": 2**20, "a minute": 60}
    for name, words in numbers.items():
        assert words in PAGE
        number = re.match(r"[\d ]*", words)[0].strip() or "1"
        unit = words.split(" ", 1)[1]
        assert getattr(serving, name) == int(number) * scale.get(unit, scale.get(words, 1)), name


@pytest.mark.parametrize("scale", [0.05, pytest.param(1.0, marks=pytest.mark.slow)])
def test_whoever_is_slow_is_cut(tmp_path: Path, scale: float) -> None:
    """Silent, a header byte by byte, a body announced and not sent, an answer not read: each in its
    time, and not before.
    """
    with started(tmp_path, scale) as (_, port):
        # The answer is larger than what the kernel keeps for a reader who does not read.
        greedy = socket.socket()
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        greedy.connect(("127.0.0.1", port))
        kinds = {
            "silent": connect(port),
            "header": connect(port),
            "body": connect(port),
            "body drips": connect(port),
        }
        begun = time.monotonic()
        announced = request(
            port, "POST /api/frame/1/done HTTP/1.1", "X-Phdtrack: 1", "Content-Length: 1000"
        )
        for name in ("body", "body drips"):
            kinds[name].sendall(announced)
        greedy.sendall(
            f"GET /still/1.jpg HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode() * 400
        )
        drips = {"header": iter(request(port)[:-4] * 100), "body drips": iter(b" " * 10**6)}
        ends = dict[str, float]()
        while kinds:
            for name, one in list(kinds.items()):
                one.settimeout(0.01)
                try:
                    if name in drips and not ends.get(name):
                        one.sendall(bytes([next(drips[name])]))
                    if one.recv(1) == b"":
                        raise ConnectionResetError
                except TimeoutError:
                    assert time.monotonic() - begun < 200
                except (ConnectionResetError, BrokenPipeError):
                    ends[name] = time.monotonic() - begun
                    one.close()
                    del kinds[name]
        for name, limit in (("silent", 15), ("header", 10), ("body", 20), ("body drips", 20)):
            assert ends[name] > 0.9 * limit * scale, name
        with greedy, pytest.raises((ConnectionResetError, BrokenPipeError)):
            until_it_fails(greedy)
        assert status(answered(port, request(port))) == 200


def until_it_fails(one: socket.socket) -> None:
    while True:
        one.sendall(b"\r\n")
        time.sleep(0.05)


def test_connections_are_limited(port: int) -> None:
    open_ = [connect(port) for _ in range(serving.OF_ADDRESS)]
    # Each has been accepted, when the last one is answered.
    open_[-1].sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    assert open_[-1].recv(12).endswith(b"200")
    others = [answered(port, b"") for _ in range(5)]
    assert all(b" 503 " in one for one in others)
    for one in open_:
        one.close()
    for _ in range(100):
        if (found := status(answered(port, request(port)))) == 200:
            break
        assert found in (503, 0)
        time.sleep(0.05)
    assert found == 200


def test_no_more_are_accepted_from_many_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "CONNECTIONS", 3)
    address = listen()
    listening = serving._Listening(address.listening)
    number = listening.getsockname()[1]
    sockets = []
    for host in ("127.0.0.2", "127.0.0.3", "127.0.0.4"):
        sockets += [
            socket.create_connection(("127.0.0.1", number), source_address=(host, 0)),
            listening.accept()[0],
        ]
    sockets.append(socket.create_connection(("127.0.0.1", number), source_address=("127.0.0.5", 0)))
    with pytest.raises(ConnectionAbortedError):
        listening.accept()
    sockets[1].close()
    sockets += [socket.create_connection(("127.0.0.1", number)), listening.accept()[0]]
    for one in (*sockets, listening):
        one.close()


@pytest.mark.parametrize(
    ("first", "more", "expected"),
    [
        ("GET /" + "a" * 2100 + " HTTP/1.1", (), 414),
        ("GET /?" + "a" * 2100 + " HTTP/1.1", (), 414),
        ("GET / HTTP/1.1", ("X: " + "a" * 17000,), (431, 400)),
        ("GET / HTTP/1.1", ("X: y",) * 4000, (431, 400)),
        ("GET /%zz HTTP/1.1", (), 400),
        ("GET /% HTTP/1.1", (), 400),
        ("GET /static/%00 HTTP/1.1", (), 400),
        ("GET /static/%ff%fe HTTP/1.1", (), 404),
        ("GET /static/" + "a" * 1000 + " HTTP/1.1", (), 404),
        ("GET /still/" + "9" * 2000 + ".jpg HTTP/1.1", (), 400),
        ("GET /crop/1/" + "9" * 30 + ".jpg HTTP/1.1", (), 400),
        ("GET /api/frame/-1 HTTP/1.1", (), 404),
        ("GET /api/frame/1.5 HTTP/1.1", (), 404),
        ("GET /api/map/walls.png HTTP/1.1", (), 400),
        ("PUT / HTTP/1.1", ("X-Phdtrack: 1",), 405),
        ("get / HTTP/1.1", (), 405),
        ("OPTIONS * HTTP/1.1", (), 405),
        ("CONNECT evil.example:80 HTTP/1.1", (), 405),
        ("TRACE / HTTP/1.1", (), 405),
        ("POST /api/overview HTTP/1.1", ("X-Phdtrack: 1", "Content-Length: 0"), 405),
        ("GET /api/frame/1/marks HTTP/1.1", (), 405),
        ("GET http://evil.example/ HTTP/1.1", (), 404),
        ("GET / HTTP/x", (), 400),
        ("GET /", (), 400),
        ("GET  / HTTP/1.1", (), 400),
        ("GET /\xe9 HTTP/1.1", (), 400),
        ("\x16\x03\x01\x02\x00\x01", (), 400),
        ("GET / HTTP/1.1", ("Host: other",), 400),
        ("GET / HTTP/1.1", ("Bad Name: x",), 400),
        ("GET / HTTP/1.1", ("Name : x",), 400),
        # Where one request ends and the next begins must not be a matter of opinion.
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Content-Length: 2", "Transfer-Encoding: chunked"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Content-Length: 2", "Content-Length: 3"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Content-Length: +2"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Content-Length: -2"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Transfer-Encoding: gzip, chunked"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Transfer-Encoding: xchunked"), 400),
        ("POST /api/frame/1/done HTTP/1.1", ("X-Phdtrack: 1", "Transfer-Encoding: chunked", "Transfer-Encoding: x"), 400),
    ],
)  # fmt: skip
def test_what_no_page_sends_is_refused(
    port: int, first: str, more: tuple[str, ...], expected: int | tuple[int, ...]
) -> None:
    head = [first, f"Host: 127.0.0.1:{port}", "Connection: close", *more]
    answer = answered(port, ("\r\n".join([*head, "", ""])).encode("latin-1"))
    assert status(answer) in (expected if isinstance(expected, tuple) else (expected,))
    assert b"Traceback" not in answer
    assert status(answered(port, request(port))) == 200


@pytest.mark.parametrize(
    ("body", "more", "expected"),
    [
        (b"", ("Content-Length: 1048577",), 413),
        (b"", ("Content-Length: 99999999999999999999",), 413),
        (b"", ("Content-Length: " + "9" * 400,), 400),
        (
            b"100001\r\n" + b" " * 0x100001 + b"\r\n0\r\n\r\n",
            ("Transfer-Encoding: chunked",),
            (413, 0),
        ),
        (b"xyz\r\n{}\r\n0\r\n\r\n", ("Transfer-Encoding: chunked",), 400),
        # Refused for its Origin while the rest of it cannot be read.
        (b"zz", ("Transfer-Encoding: chunked", "Origin: http://evil.example"), (400, 403)),
        (b"-1\r\n{}\r\n0\r\n\r\n", ("Transfer-Encoding: chunked",), 400),
        (b'{"marks": ' + b"[" * 100_000, (), 400),
        (b'{"marks": [{"frame": 1' + b"0" * 5000 + b', "box": 0, "mark": "false"}]}', (), 400),
        (b'{"marks": [{"frame": 1, "box": 1e400, "mark": "false"}]}', (), 400),
        (b'{"marks": [{"frame": null, "box": [], "mark": {}}]}', (), 400),
        (b'{"marks": [' + b'{"frame": 1, "box": 0, "mark": "false"},' * 10_001 + b"]}", (), 400),
        (b'{"who": "\xff\xfe", "marks": []}', (), 400),
        (b'{"who": "\\ud800", "marks": [{"frame": 1, "box": 0, "mark": "none"}]}', (), 400),
        (b"\xff" * 1000, (), 400),
    ],
)
def test_bodies_that_cannot_be_used(
    port: int, body: bytes, more: tuple[str, ...], expected: object
) -> None:
    answer = answered(port, post(port, body, *more))
    assert status(answer) in (expected if isinstance(expected, tuple) else (expected,))
    assert b"Traceback" not in answer
    assert b'"false":0' in answered(port, request(port, "GET /api/overview HTTP/1.1"))


@pytest.mark.parametrize("what", ["marks", "undo", "redo", "done"])
def test_frames_that_there_are_not_are_not_changed(port: int, what: str) -> None:
    for number in ("9" * 30, "9" * 400, "0", "41"):
        assert status(answered(port, post(port, b"{}", path=f"/api/frame/{number}/{what}"))) == 400


def test_marks_of_one_request_are_limited(port: int) -> None:
    one = b'{"frame": 1, "box": 0, "mark": "none"}'
    assert b"at most 10000" in answered(
        port, post(port, b'{"marks": [' + b",".join([one] * 10_001) + b"]}")
    )
    assert (
        status(answered(port, post(port, b'{"marks": [' + b",".join([one] * 10_000) + b"]}")))
        == 200
    )
    assert "10000 marks" in PAGE


def test_many_requests_on_one_connection_are_each_answered(port: int) -> None:
    with connect(port) as one:
        for path, expected in (("/", b"200"), ("/none", b"404"), ("/api/overview", b"200")):
            one.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            got = b""
            while b"\r\n\r\n" not in got:
                got += one.recv(65536)
            assert got.split(b" ")[1] == expected
            head, _, body = got.partition(b"\r\n\r\n")
            length = int(re.search(rb"content-length: (\d+)", head)[1])
            while len(body) < length:
                body += one.recv(65536)
    assert (
        answered(port, request(port).replace(b"Connection: close\r\n", b"") + request(port)).count(
            b"HTTP/1.1 200"
        )
        == 2
    )


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


async def hello(scope, receive, send) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"hello"})


def clients(clock: Clock, *addresses: str) -> list[TestClient]:
    app = Guard(hello, frozenset({"testserver"}), "right", clock=clock)
    return [TestClient(app, client=(address, 1)) for address in addresses]


def test_tokens_cannot_be_guessed_and_the_owner_is_let_in_again() -> None:
    clock = Clock()
    several = (f"fd00:0:0:{k:x}::1" for k in range(20))
    owner, thief, other, *many = clients(clock, "10.0.0.1", "10.0.0.2", "10.0.0.3", *several)
    # No token is no guess.
    for _ in range(20):
        assert thief.get("/").status_code == 401
    for k in range(serving.GUESSES):
        assert thief.get(f"/?token=wrong{k}").status_code == 401
    answer = thief.get("/?token=right")
    assert (answer.status_code, answer.headers["retry-after"]) == (429, "60")
    assert thief.get("/").status_code == 401
    assert owner.get("/?token=right").status_code == 200
    clock.now = serving.GUESSING
    assert thief.get("/?token=right").status_code == 200
    # Of all addresses together: who was let in before is let in, others wait.
    said = [one.get("/?token=wrong").status_code for one in many for _ in range(6)]
    assert said == [401] * serving.ALL_GUESSES + [429] * 20
    assert owner.get("/").status_code == 200
    assert other.get("/?token=right").status_code == 429
    clock.now += serving.GUESSING
    assert other.get("/?token=right").status_code == 200


def test_an_ipv6_network_counts_as_one_address() -> None:
    assert serving._network("fe80::1%eth0") == serving._network("fe80::2") == "fe80::/64"
    assert serving._network("10.0.0.1") == "10.0.0.1"


def test_names_that_are_allowed_are_answered_and_need_the_token() -> None:
    for host, allow, url in (
        ("127.0.0.1", [], "http://127.0.0.1:{}/"),
        ("127.0.0.1", ["Cam.example.org"], "http://Cam.example.org:{}/?token="),
        ("0.0.0.0", ["192.168.1.5", "[fd00::5]:90"], "http://192.168.1.5:{}/?token="),
        ("0.0.0.0", [], f"http://{socket.gethostname()}:{{}}/?token="),
    ):
        address = listen(host, 0, allow)
        number = address.listening.getsockname()[1]
        assert address.url.startswith(url.format(number))
        assert bool(address.token) == ("token" in url)
        for name in allow:
            for one in (name, name.lower(), f"{name}:{number}"):
                client = TestClient(
                    Guard(hello, address.hosts, address.token),
                    base_url=f"http://127.0.0.1:{number}",
                )
                assert (
                    client.get(
                        "/", headers={"host": one}, params={"token": address.token}
                    ).status_code
                    == 200
                )
                assert (
                    client.get(
                        "/", headers={"host": one, "origin": "http://evil.example"}
                    ).status_code
                    == 403
                )
        assert (
            client.get("/", headers={"host": "evil.example"}).status_code == 421 if allow else True
        )
        address.listening.close()
    for name in ("http://cam", "a/b", "*", "", "cam:port", "a b", "-a"):
        with pytest.raises(InputError, match="--allow-host"):
            listen(allow=[name])


def pair(folder: Path, *more: str) -> tuple[Path, Path]:
    certificate = folder / "certificate.pem"
    key = folder / "key.pem"
    words = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-days",
        "2",
        "-subj",
        "/CN=cam.example.org",
    ]
    words += [
        "-addext",
        "subjectAltName=DNS:cam.example.org",
        "-keyout",
        str(key),
        "-out",
        str(certificate),
    ]
    subprocess.run([*words, *(more or ("-nodes",))], check=True, capture_output=True)
    return certificate, key


needs_openssl = pytest.mark.skipif(
    not shutil.which("openssl"), reason="needs openssl, to make a certificate"
)


@needs_openssl
def test_with_a_certificate_it_speaks_tls_only_and_its_cookie_is_secure(tmp_path: Path) -> None:
    certificate, _ = pair(tmp_path)
    with started(tmp_path, host="tls") as (url, port):
        assert url.startswith(f"https://cam.example.org:{port}/?token=")
        context = ssl.create_default_context(cafile=certificate)

        def asked(path: str, *more: str) -> bytes:
            lines = [
                f"GET {path} HTTP/1.1",
                f"Host: cam.example.org:{port}",
                "Connection: close",
                *more,
                "",
                "",
            ]
            with (
                connect(port) as plain,
                context.wrap_socket(plain, server_hostname="cam.example.org") as one,
            ):
                assert one.version() in ("TLSv1.2", "TLSv1.3")
                one.sendall("\r\n".join(lines).encode())
                return b"".join(iter(lambda: one.recv(65536), b""))

        assert status(asked("/")) == 401
        answer = asked("/" + url.rsplit("/", 1)[1])
        assert status(answer) == 200
        cookie = re.search(rb"set-cookie: (\S+); (.*)\r\n", answer)
        assert {b"HttpOnly", b"Secure", b"SameSite=strict"} <= set(cookie[2].split(b"; "))
        own = ("Cookie: " + cookie[1].decode(), f"Origin: https://cam.example.org:{port}")
        assert status(asked("/api/overview", *own)) == 200
        assert (
            status(asked("/api/overview", own[0], f"Origin: http://cam.example.org:{port}")) == 403
        )
        # Who speaks no TLS, or an old one, gets nothing.
        assert status(answered(port, request(port))) == 0
        old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        old.check_hostname = False
        old.verify_mode = ssl.CERT_NONE
        old.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.minimum_version = old.maximum_version = ssl.TLSVersion.TLSv1_1
        with connect(port) as plain, pytest.raises((ssl.SSLError, ConnectionResetError)):
            old.wrap_socket(plain)


@needs_openssl
def test_certificates_that_cannot_be_used_are_said(tmp_path: Path) -> None:
    certificate, key = pair(tmp_path)
    (tmp_path / "other").mkdir()
    _, other = pair(tmp_path / "other")
    (tmp_path / "locked").mkdir()
    sealed = pair(tmp_path / "locked", "-passout", "pass:secret")
    junk = tmp_path / "junk.pem"
    junk.write_bytes(b"no certificate\n")
    for given, words in (
        ((certificate, None), "one of them"),
        ((None, key), "one of them"),
        ((tmp_path / "none.pem", key), "No such file"),
        ((tmp_path, key), "directory|PEM"),
        ((junk, key), "openssl req"),
        ((certificate, junk), "openssl req"),
        ((certificate, other), "MISMATCH"),
        (sealed, "not encrypted"),
    ):
        with pytest.raises(InputError, match=words):
            listen("127.0.0.1", 0, (), *given)
