"""`phdtrack live` as it is started: what it writes and sends, how it ends, and that no password
leaves it.
"""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import typer
from camera_server import CameraServer, until, walker
from typer.testing import CliRunner

from phdtrack.cli.app import application
from phdtrack.cli.live import LiveOptions, camera_settings, logged_state, named_sources
from phdtrack.cli.options import size
from phdtrack.cli.output import Output
from phdtrack.live.engine import Camera, CameraSettings
from phdtrack.live.events import Watch
from phdtrack.run.requests import TrackingRequest
from phdtrack.types import SequenceInfo
from phdtrack.video.live_sources import SourceStatus

pytestmark = pytest.mark.slow

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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_ends_it_while_a_camera_is_frozen(tmp_path: Path, name: str) -> None:
    camera = CameraServer()
    hook = ThreadingHTTPServer(("127.0.0.1", 0), Hook)
    hook.taken = []
    camera.draw = walker  # type: ignore[attr-defined]
    threading.Thread(target=hook.serve_forever, daemon=True).start()
    out = tmp_path / "out"
    port = free_port()
    address = camera.url.replace("://", f"://bob:{SECRET}@") + f"?token={SECRET}"
    dead = f"rtsp://bob:{SECRET}@127.0.0.1:{free_port()}/x"
    words = [
        sys.executable,
        "-m",
        "phdtrack",
        "live",
        f"gate={address}",
        f"dead={dead}",
        "--out",
        str(out),
        "--json",
    ]
    words += [
        "--webhook",
        f"http://127.0.0.1:{hook.server_port}/{SECRET}",
        "--allow-private",
        "--port",
        str(port),
    ]
    # One that nobody answers, so that a problem is said.
    words += ["--webhook", f"http://bob:{SECRET}@127.0.0.1:{free_port()}/{SECRET}?token={SECRET}"]
    words += ["--set", "detector.min_area=0.005", "--config", str(tmp_path / "mine.toml")]
    (tmp_path / "mine.toml").write_text("")
    served = list[bytes]()

    def asked(path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=600) as answer:
            served.append(answer.read())
        return served[-1]

    with (tmp_path / "stdout").open("wb") as stdout, (tmp_path / "stderr").open("wb") as stderr:
        child = subprocess.Popen(words, stdout=stdout, stderr=stderr)
        try:
            until(lambda: hook.taken)  # type: ignore[attr-defined]
            until(lambda: "down" in (tmp_path / "stdout").read_text())
            for path in (
                "/",
                "/metrics",
                "/healthz",
                "/api/cameras",
                "/api/camera/gate",
                "/api/camera/dead",
            ):
                asked(path)
            until(lambda: asked("/picture/gate.jpg").startswith(b"\xff\xd8"))
            assert json.loads(asked("/api/camera/dead"))["problem"]
            assert "events wait to be sent" in str(
                json.loads(asked("/api/camera/gate"))["problems"]
            )
            # Settings that cannot be used are said, and change nothing.
            (tmp_path / "mine.toml").write_text(f'[filter]\nkind = "{SECRET}"\n')
            until(lambda: json.loads(asked("/api/camera/gate"))["problems"])
            served.pop()
            camera.frozen = True
            # Nothing comes any more, and what came is through.
            until(
                lambda: (
                    {one["name"]: one["state"] for one in json.loads(asked("/api/cameras"))}["gate"]
                    == "silent"
                )
            )
            until(lambda: len({taken(asked("/metrics")) for _ in range(6)}) == 1)
            begun = time.monotonic()
            child.send_signal(getattr(signal, name))
            assert child.wait(600) == 0, (tmp_path / "stderr").read_text()
            # Not for ever, nor until a time-out; two seconds are asked for.
            assert time.monotonic() - begun < 60
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
    everything += [
        json.dumps([line for line in said if SECRET not in str(line.get("problems"))]).encode()
    ]
    assert not any(SECRET.encode() in one or b"bob" in one for one in everything)


def taken(metrics: bytes) -> int:
    """How many pictures went through the tracker, asked 0.2 s after the one before."""
    time.sleep(0.2)
    (line,) = re.findall(rb'^phdtrack_frames_total{camera="gate"} (\d+)$', metrics, re.MULTILINE)
    return int(line)


def test_it_ends_by_itself_and_says_what_it_did(tmp_path: Path) -> None:
    camera = CameraServer()
    camera.mute = True
    status, said = invoked(
        f"gate={camera.url}",
        "--out",
        str(tmp_path),
        "--no-page",
        "--duration",
        "0.5",
        "--video",
        "0",
    )
    camera.kill()
    assert status == 0, said
    assert f"gate: no frames, no events: {tmp_path / 'gate'}" in said
    assert not (tmp_path / "gate" / "video").exists()


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (0, ""),
        (1, "gate: 1 object came back and got its identity again"),
        (3, "gate: 3 objects came back and got their identities again"),
    ],
)
def test_it_says_how_many_came_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, words: str
) -> None:
    monkeypatch.setattr(Camera, "returned", property(lambda one: count))
    camera = CameraServer()
    camera.mute = True
    options = ("--no-page", "--duration", "0.5", "--video", "0")
    status, said = invoked(f"gate={camera.url}", "--out", str(tmp_path), *options)
    camera.kill()
    assert status == 0, said
    assert words in said
    assert ("came back" in said) == (count > 0)


def test_nobody_else_writes_into_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (
        "import pathlib, sys\nfrom phdtrack.run.directory import"
        " claim\nclaim(pathlib.Path(sys.argv[1]), False, {})"
    )
    said = list[str]()

    start = Camera.start

    def started(*given: object) -> None:
        start(*given)  # type: ignore[arg-type]
        said.append(
            subprocess.run(
                [sys.executable, "-c", code, tmp_path], capture_output=True, text=True
            ).stderr
        )

    monkeypatch.setattr(Camera, "start", started)
    address = f"gate=http://127.0.0.1:{free_port()}/x"
    words = ["--out", str(tmp_path), "--no-page", "--duration", "0.01"]
    assert invoked(address, *words)[0] == 0
    assert "another run is writing into this directory" in said[0]


def test_it_goes_on_where_stderr_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = list[str]()

    def full(self: Output, text: str) -> None:
        tried.append(text)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Output, "note", full)
    address = f"gate=http://127.0.0.1:{free_port()}/x"
    status, said = invoked(address, "--out", str(tmp_path), "--no-page", "--duration", "2")
    assert tried
    assert status == 0, said


def test_options_are_the_cameras(tmp_path: Path) -> None:
    write = LiveOptions(
        places=["a=mine.toml", "all.toml"],
        video=0.0,
        quota="2k",
        parquet=True,
        dwell=7.0,
        leave_after=2.0,
        snapshots=30,
    )
    found = {name: camera_settings(name, write, None, tmp_path) for name in ("a", "b")}
    usual = CameraSettings(
        tmp_path / "b",
        Path("all.toml"),
        None,
        Watch(dwell=7.0, leave_after=2.0),
        0.0,
        2000,
        True,
        checkpoint=10.0,
        snapshots=30,
    )
    assert found == {
        "a": replace(usual, folder=tmp_path / "a", places=Path("mine.toml")),
        "b": usual,
    }
    alone = camera_settings("c", LiveOptions(), None, tmp_path)
    assert alone.places == tmp_path / "c" / "places.toml"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["missing.mp4"], "there is no such file"),
        (["a=0", "a=1"], "two sources are called a"),
        (["a/b=http://127.0.0.1:9/x"], "'a/b' is no name of a camera"),
        (["0", "--places", "missing.toml"], "there is no such file of lines and zones"),
        ([f"rtsp://bob:12/{SECRET}@127.0.0.1/stream"], "Write / in a password as %2F"),
        (["gate=rtsp://[::1/stream"], "this is not an address"),
        (["gate=rtsp://bob:[" + SECRET + "]@127.0.0.1/x"], "this is not an address"),
        (["0", "--mqtt", f"mqtt://bob:{SECRET}/x@host/x"], "--mqtt: expected an address"),
        (["0", "--quota", "much"], "expected a size as 500MB"),
        (["0", "--blur", "hands"], "expected boxes or faces"),
        (
            ["0", "--webhook", f"ftp://bob:{SECRET}@example.com"],
            "expected an address that begins with http",
        ),
        (["0", "--mqtt", "mqtt://localhost"], "pip install 'phdtrack[mqtt]'"),
        (["0", "--home-assistant"], "--home-assistant: no broker is given"),
        (["0", "--truth", "gt.txt"], "no annotated truth"),
        (["0", "--filter", "magic"], "magic"),
        (["0", "--detector", "magic"], "no detector 'magic'"),
    ],
)
def test_what_cannot_be_used_is_said_at_once(tmp_path: Path, words: list[str], said: str) -> None:
    status, output = invoked(*words, "--out", str(tmp_path / "out"), "--no-page")
    assert status != 0
    result = CliRunner().invoke(
        application("live"), ["live", *words, "--out", str(tmp_path / "out"), "--no-page"]
    )
    assert said in output + str(result.exception)
    assert SECRET not in output


def test_sources_have_names_and_sizes_are_read() -> None:
    found = named_sources(["gate=rtsp://u:p@host/x?a=b", "http://cam.example/a?b=c", "0"])
    assert found == {
        "gate": "rtsp://u:p@host/x?a=b",
        "cam.example-a": "http://cam.example/a?b=c",
        "0": "0",
    }
    assert [size(text) for text in ("", "1000", "20GB", "1.5 k", "2T")] == [
        0,
        1000,
        20 * 10**9,
        1500,
        2 * 10**12,
    ]
    with pytest.raises(typer.BadParameter):
        size("0")


def test_settings_are_those_of_track_with_bounded_history() -> None:
    from phdtrack.live.camera_setup import CameraSetup

    make = CameraSetup(TrackingRequest(), (), "change", 0, None)
    made = make(SequenceInfo(64, 48, 10.0))
    assert make.settings().build("associate").history > 0
    assert make.settings().preset == "background"
    assert made.groups is None
    assert {"filter.kind", "detector.min_area"} <= {*made.fixed, "detector.min_area"}
    assert CameraSetup(TrackingRequest(sets=["motion.kind=plane"]), (), "person", 0, None)(
        SequenceInfo(64, 48, 10.0)
    ).groups


def test_log_lines_have_times_and_present_problems(tmp_path: Path) -> None:
    words = ["gate=rtsp://127.0.0.1:9/", "--out", str(tmp_path), "--no-page", "--duration", "1"]
    result = CliRunner().invoke(application("live"), ["live", *words])
    time = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z"
    found = re.findall(rf"^phdtrack: {time} gate: down: Connection refused$", result.stderr, re.M)
    assert len(found) == 1, result.stderr
    assert logged_state(SourceStatus("down", problem="refused")) == ("down", "refused")
    assert logged_state(SourceStatus("connecting", problem="refused")) == ("down", "refused")
    assert logged_state(SourceStatus("connecting")) == ("connecting", "")
    assert logged_state(SourceStatus("live", problem="refused")) == ("live", "")
    assert logged_state(SourceStatus("silent", problem="refused")) == ("silent", "")
