"""`phdtrack live` as it is started: what it writes and sends, how it ends, and that no password leaves it."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from camera_server import CameraServer, until, walker
from typer.testing import CliRunner

from phdtrack.cli.app import application
from phdtrack.cli.live import named_sources, size
from phdtrack.cli.options import TrackingOptions
from phdtrack.errors import InputError
from phdtrack.types import SequenceInfo

SECRET = "secret99"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as one:
        return one.getsockname()[1]


class Hook(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.taken.append((str(self.headers), body))  # type: ignore[attr-defined]
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


def invoked(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(application("live"), ["live", *words])
    return result.exit_code, result.output


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_it_ends_on_a_signal_while_a_camera_is_frozen_and_tells_nobody_the_password(tmp_path: Path, name: str) -> None:
    camera, hook = CameraServer(), ThreadingHTTPServer(("127.0.0.1", 0), Hook)
    hook.taken, camera.draw = [], walker  # type: ignore[attr-defined]
    threading.Thread(target=hook.serve_forever, daemon=True).start()
    out, port, address = tmp_path / "out", free_port(), camera.url.replace("://", f"://bob:{SECRET}@") + f"?token={SECRET}"
    dead = f"rtsp://bob:{SECRET}@127.0.0.1:{free_port()}/x"
    words = [sys.executable, "-m", "phdtrack", "live", f"gate={address}", f"dead={dead}", "--out", str(out), "--json"]
    words += ["--webhook", f"http://127.0.0.1:{hook.server_port}/{SECRET}", "--allow-private", "--port", str(port)]
    # One that nobody answers, so that a problem is said.
    words += ["--webhook", f"http://bob:{SECRET}@127.0.0.1:{free_port()}/{SECRET}?token={SECRET}"]
    words += ["--set", "detector.min_area=0.005", "--config", str(tmp_path / "mine.toml")]
    (tmp_path / "mine.toml").write_text("")
    served = list[bytes]()

    def asked(path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as answer:
            served.append(answer.read())
        return served[-1]

    with (tmp_path / "stdout").open("wb") as stdout, (tmp_path / "stderr").open("wb") as stderr:
        child = subprocess.Popen(words, stdout=stdout, stderr=stderr)
        try:
            until(lambda: hook.taken)  # type: ignore[attr-defined]
            until(lambda: "down" in (tmp_path / "stdout").read_text())
            for path in ("/", "/metrics", "/healthz", "/api/cameras", "/api/camera/gate", "/api/camera/dead"):
                asked(path)
            assert asked("/picture/gate.jpg").startswith(b"\xff\xd8")
            assert json.loads(asked("/api/camera/dead"))["problem"]
            assert "events wait to be sent" in str(json.loads(asked("/api/camera/gate"))["problems"])
            # Settings that cannot be used are said, and change nothing.
            (tmp_path / "mine.toml").write_text(f'[filter]\nkind = "{SECRET}"\n')
            until(lambda: json.loads(asked("/api/camera/gate"))["problems"])
            served.pop()
            camera.frozen = True
            time.sleep(0.5)
            begun = time.monotonic()
            child.send_signal(getattr(signal, name))
            assert child.wait(20) == 0, (tmp_path / "stderr").read_text()
            assert time.monotonic() - begun < 15
        finally:
            child.kill()
            child.wait()
            camera.kill()
            hook.shutdown()
            hook.server_close()
    assert list(out.rglob("*.part")) == []
    kept = [json.loads(line) for line in (out / "gate" / "events.jsonl").read_text().splitlines()]
    said = [json.loads(line) for line in (tmp_path / "stdout").read_text().splitlines()]
    assert [line for line in said if line["kind"] != "source"] == kept
    assert {line["state"] for line in said if line.get("source") == "dead"} >= {"down"}
    assert [json.loads(body) for _, body in hook.taken] == kept[: len(hook.taken)]  # type: ignore[attr-defined]
    assert list((out / "gate" / "tracks").glob("*.csv"))
    assert list((out / "gate" / "video").glob("*.mp4"))
    everything = [path.read_bytes() for path in out.rglob("*") if path.is_file()]
    everything += [(tmp_path / "stderr").read_bytes(), *served, *(body for _, body in hook.taken)]  # type: ignore[attr-defined]
    everything += [json.dumps([line for line in said if SECRET not in str(line.get("problems"))]).encode()]
    assert not any(SECRET.encode() in one or b"bob" in one for one in everything)


def test_it_ends_by_itself_and_says_what_it_did(tmp_path: Path) -> None:
    camera = CameraServer()
    camera.draw = walker
    words = [
        "--out",
        str(tmp_path),
        "--no-page",
        "--duration",
        "4",
        "--parquet",
        "--video",
        "0",
        "--set",
        "detector.min_area=0.005",
    ]
    status, said = invoked(camera.url, *words)
    camera.kill()
    assert status == 0, said
    assert "frames" in said
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert list((folder / "tracks").glob("*.parquet"))
    assert not (folder / "video").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["missing.mp4"], "there is no such file"),
        (["a=0", "a=1"], "two sources are called a"),
        (["0", "--quota", "much"], "expected a size as 20GB"),
        (["0", "--blur", "hands"], "expected boxes or faces"),
        (["0", "--webhook", f"ftp://bob:{SECRET}@example.com"], "expected an address that begins with http"),
        (["0", "--mqtt", "mqtt://localhost"], "pip install 'phdtrack[mqtt]'"),
        (["0", "--truth", "gt.txt"], "no annotated truth"),
        (["0", "--filter", "magic"], "magic"),
        (["0", "--detector", "magic"], "no detector 'magic'"),
    ],
)
def test_what_cannot_be_used_is_said_at_once(tmp_path: Path, words: list[str], said: str) -> None:
    status, output = invoked(*words, "--out", str(tmp_path / "out"), "--no-page")
    assert status != 0
    result = CliRunner().invoke(application("live"), ["live", *words, "--out", str(tmp_path / "out"), "--no-page"])
    assert said in output + str(result.exception)
    assert SECRET not in output


def test_sources_have_names_and_sizes_are_read() -> None:
    found = named_sources(["gate=rtsp://u:p@host/x?a=b", "http://cam.example/a?b=c", "0"])
    assert found == {"gate": "rtsp://u:p@host/x?a=b", "cam.example-a": "http://cam.example/a?b=c", "0": "0"}
    assert [size(text) for text in ("", "1000", "20GB", "1.5 k", "2T")] == [0, 1000, 20 * 10**9, 1500, 2 * 10**12]
    with pytest.raises(InputError):
        size("0")


def test_settings_are_those_of_track_with_a_past_that_is_forgotten() -> None:
    from phdtrack.cli.live import Maker

    make = Maker(TrackingOptions(), (), "change", 0, None)
    made = make(SequenceInfo(64, 48, 10.0))
    assert make.settings().build("associate").history > 0
    assert make.settings().preset == "mot15"
    assert made.groups is None
    assert {"filter.kind", "detector.min_area"} <= {*made.fixed, "detector.min_area"}
    assert Maker(TrackingOptions(sets=["motion.kind=plane"]), (), "person", 0, None)(SequenceInfo(64, 48, 10.0)).groups
