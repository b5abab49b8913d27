"""Addresses of pages, certificates, and a server as it is started."""

from __future__ import annotations

import contextlib
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from phdtrack.errors import InputError
from phdtrack.web.serving import listen

PROGRAM = """
import os
import sys
import time
from pathlib import Path
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from phdtrack.web.endpoints import endpoint
from phdtrack.web.serving import listen, serve

async def hello(request):
    return PlainTextResponse("hello")

def wait():
    print("waits", flush=True)
    time.sleep(60)

files = [Path(name) for name in sys.argv[2:]] or [None, None]
address = listen("127.0.0.1", 0, sys.argv[1].split(), *files)
print(address.url, flush=True)
serve(Starlette(routes=[Route("/", hello), Route("/wait", endpoint(wait))]), address)
print("ended in order", flush=True)
# As the commands end: threads that answer a request are left behind.
os._exit(0)
"""


@contextlib.contextmanager
def started(allow: str = "", *files: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address and the process of a page that answers with hello."""
    words = [sys.executable, "-c", PROGRAM, allow, *map(str, files)]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        yield child.stdout.readline().strip(), child
    finally:
        child.kill()
        child.communicate()


def body(url: str, context: ssl.SSLContext | None = None) -> bytes:
    with urllib.request.urlopen(url, timeout=30, context=context) as answer:
        found: bytes = answer.read()
        return found


@pytest.mark.parametrize(("host", "allow", "url"), [
    ("127.0.0.1", [], "http://127.0.0.1:{}/"),
    ("localhost", [], "http://localhost:{}/"),
    ("127.0.0.1", ["Cam.example.org"], "http://Cam.example.org:{}/?token="),
    ("0.0.0.0", ["192.168.1.5", "[fd00::5]:90"], "http://192.168.1.5:{}/?token="),
    ("0.0.0.0", ["cam:90"], "http://cam:90/?token="),
    ("0.0.0.0", [], f"http://{socket.gethostname()}:{{}}/?token="),
])  # fmt: skip
def test_an_address_beyond_loopback_has_a_token(host: str, allow: list[str], url: str) -> None:
    address = listen(host, 0, allow)
    with address.listening:
        number = address.listening.getsockname()[1]
        assert address.url.startswith(url.format(number))
        assert bool(address.token) == ("token" in url)
        assert {name.split(":9")[0] for name in allow} <= set(address.hosts)


def test_a_port_that_is_taken_is_refused() -> None:
    with listen().listening as taken, pytest.raises(InputError, match="cannot listen on"):
        listen("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(InputError, match="cannot listen on"):
        listen("no such host")


def test_the_first_free_preferred_port_is_taken() -> None:
    with listen().listening as taken, listen().listening as free:
        number = free.getsockname()[1]
        free.close()
        with listen(preferred=[taken.getsockname()[1], number]).listening as found:
            assert found.getsockname()[1] == number


@pytest.mark.parametrize("name", ["http://cam", "a/b", "*", "", "cam:port", "a b", "-a"])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="--allow-host"):
        listen(allow=[name])


@pytest.mark.slow
def test_a_page_is_served_until_ctrl_c() -> None:
    with started() as (url, child):
        assert body(url) == b"hello"
        with pytest.raises(urllib.error.HTTPError, match="404"):
            body(url + "none")
        child.send_signal(signal.SIGINT)
        out, errors = child.communicate(timeout=30)
        assert (child.returncode, out, errors) == (0, "ended in order\n", "")


@pytest.mark.slow
def test_a_request_that_is_cut_off_at_the_end_is_no_error() -> None:
    with started() as (url, child):
        port = int(url.rpartition(":")[2].strip("/"))
        with socket.create_connection(("127.0.0.1", port)) as asking:
            asking.sendall(b"GET /wait HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert child.stdout is not None
            assert child.stdout.readline() == "waits\n"
            child.send_signal(signal.SIGINT)
            out, errors = child.communicate(timeout=30)
        assert (child.returncode, out, errors) == (0, "ended in order\n", "")


def pair(folder: Path, *more: str) -> tuple[Path, Path]:
    """A certificate for 127.0.0.1 and its key."""
    folder.mkdir(exist_ok=True)
    certificate = folder / "certificate.pem"
    key = folder / "key.pem"
    words = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-days", "2", "-subj", "/CN=cam"]
    words += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key)]
    words += ["-out", str(certificate), *(more or ("-nodes",))]
    subprocess.run(words, check=True, capture_output=True)
    return certificate, key


needs_openssl = pytest.mark.skipif(
    not shutil.which("openssl"), reason="needs openssl, to make a certificate"
)


@pytest.mark.slow
@needs_openssl
def test_with_a_certificate_only_tls_is_answered(tmp_path: Path) -> None:
    certificate, key = pair(tmp_path)
    with started("cam.example.org", certificate, key) as (url, _):
        assert url.startswith("https://cam.example.org:")
        here = url.replace("cam.example.org", "127.0.0.1")
        context = ssl.create_default_context(cafile=certificate)
        assert body(here, context) == b"hello"
        with pytest.raises(OSError, match="certificate"):
            body(here)
        with pytest.raises(OSError, match=r"Remote end closed|reset"):
            body(here.replace("https", "http"))


@needs_openssl
def test_an_unusable_certificate_is_refused(tmp_path: Path) -> None:
    certificate, key = pair(tmp_path)
    _, other = pair(tmp_path / "other")
    sealed = pair(tmp_path / "locked", "-passout", "pass:secret")
    junk = tmp_path / "junk.pem"
    junk.write_bytes(b"no certificate\n")
    for files, message in (
        ((certificate, None), "one of them"),
        ((None, key), "one of them"),
        ((tmp_path / "none.pem", key), "No such file"),
        ((tmp_path, key), "directory|PEM"),
        ((junk, key), "openssl req"),
        ((certificate, junk), "openssl req"),
        ((certificate, other), "MISMATCH"),
        (sealed, "not encrypted"),
    ):
        with pytest.raises(InputError, match=message):
            listen("127.0.0.1", 0, (), *files)
