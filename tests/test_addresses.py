"""Secrets of addresses are hidden wherever cameras expect them, and need not stand in a command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from cli.cli_runner import phdtrack
from phdtrack.addresses import filled, named, resolved, shown
from phdtrack.cli import signals
from phdtrack.cli.app import COMMANDS, main
from phdtrack.cli.live import named_sources
from phdtrack.errors import InputError
from phdtrack.run import camera_input
from phdtrack.video.live_sources import LiveSource, check_address

# Addresses of cameras with passwords that begin with SE, and what is shown of them.
ADDRESSES = [
    (
        "rtsp://h:9/user=admin_password=SECRETA1_channel=1_stream=0.sdp?real_stream",
        "rtsp://h:9/user=…_password=…_channel=1_stream=0.sdp?real_stream",
    ),
    (
        "http://h:9/videostream.cgi?loginuse=admin&loginpas=SECRETB2",
        "http://h:9/videostream.cgi?loginuse=…&loginpas=…",
    ),
    ("http://h:9/snap.cgi?usr=admin&pwd=SE.C=R&resolution=640x480", None),
    ("http://h:9/snapshot.cgi?account=admin&pass_word=SECRET&channel=2", None),
    ("http://h:9/a?auth=SEVDUkVU&codec=h264", "http://h:9/a?auth=…&codec=h264"),
    ("http://h:9/a?p%61ss=SECRET", "http://h:9/a?…"),
    ("http://h:9/a?SECRETTOKEN", "http://h:9/a?…"),
    ("rtsp://u:SE/CR#ET C3@h/live", "rtsp://…@h/live"),
    ("rtsp://u:SE@CR?ET=4&x@h:554/a", "rtsp://…"),
    ("rtsp://u:SE@CR@h:554/a", "rtsp://…@h:554/a"),
    ("rtsp://john.smith:12/SECRET@h/live", "rtsp://…"),
    ("http://h/0/admin:SE@SECRET/main", "http://…"),
    ("http://h:9/live?SECRETxyz0==", "http://h:9/live?…"),
    ("rtsp://h:7447/SEaBcDeFgH1jKl?enableSrtp", "rtsp://h:7447/…?enableSrtp"),
    ("rtsp://h:9/0/admin:SECRET/main", "rtsp://h:9/0/…/main"),
    ("rtsp://h:9/login/SECRET/ch1", "rtsp://h:9/login/…/ch1"),
    ("rtsp://h:9/user=admin_password=SE/CRET_channel=1.sdp", None),
    ("rtsp://u:SECRET://SE@h/live", None),
    ("http://h:9/a?pwd=SECRET://SECRET&channel=1", "http://h:9/a?pwd=…&channel=1"),
    ("rtsp:/u:SECRET@h/live", "rtsp:/…@h/live"),
    ("admin:SECRET@10.0.0.5/live", "…@10.0.0.5/live"),
]
HARMLESS = [
    "rtsp://h/Streaming/Channels/101",
    "rtsp://h/axis-media/media.amp?videocodec=h264&resolution=640x480",
    "http://h/cam/realmonitor?channel=1&subtype=0",
    "https://example.org/videos/street_2024-11-28.mp4",
    "rtsp://10.0.0.5:554/live/ch00_0",
    "file:///home/me/a:b@c.mp4",
    "/data/a:b@c=d.mp4",
    "street=1, a: b@c",
]


@pytest.mark.parametrize(("address", "masked"), ADDRESSES)
def test_passwords_are_hidden_where_cameras_expect_them(address: str, masked: str | None) -> None:
    for text in (address, f"gate={address}", f"cannot open '{address}': refused"):
        assert "SE" not in shown(text)
        assert shown(shown(text)) == shown(text)
    assert "SE" not in named(address)
    assert "SE" not in str(InputError("no answer", where=f"{address}, frame 3"))
    if masked is not None:
        assert shown(address) == masked


@pytest.mark.parametrize("text", HARMLESS)
def test_what_is_harmless_is_shown(text: str) -> None:
    assert shown(text) == text


@pytest.mark.parametrize(("number", "command"), list(enumerate(COMMANDS)))
def test_no_command_prints_or_writes_a_password(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    number: int,
    command: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(signals, "listen", lambda: None)
    monkeypatch.setattr(signals, "leave", sys.exit)
    monkeypatch.setattr(camera_input, "LiveSource", partial(LiveSource, connect=0.2))
    for address in [address for address, _ in ADDRESSES][number % 4 :: 4]:
        words = [command, address]
        if command in ("demo", "simulate", "live"):
            words = [command, "--no-such-option", address]
        monkeypatch.setattr(sys, "argv", ["phdtrack", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code in (1, 2)
        assert "SE" not in "".join(capfd.readouterr()).replace("SOURCE", "")
        assert not any(b"SE" in file.read_bytes() for file in tmp_path.rglob("*.*"))


def test_live_prints_and_writes_no_password(tmp_path: Path) -> None:
    sources = [
        f"c{k}={address}" for k, (address, _) in enumerate(ADDRESSES[:7]) if "@" not in address
    ]
    hook = ["--webhook", "http://127.0.0.1:9/?loginpas=SECRET"]
    said = phdtrack(
        "live", *sources, *hook, "--duration", 1, "--json", "--no-page", "--out", tmp_path
    )
    assert '"kind": "source"' in said.out
    assert "SE" not in said.out + said.err
    assert not any(b"SECRET" in file.read_bytes() for file in tmp_path.rglob("*.*"))


def test_run_json_of_a_remote_video_has_no_password(tmp_path: Path) -> None:
    (tmp_path / "d.txt").write_text("1,-1,3,4,20,20,.9\n")
    words = [
        "track",
        "--detections",
        "d.txt",
        "--frame-size",
        "64x48",
        "--fps",
        "9",
        "--out",
        "run",
        "--set",
    ]
    setting = "classes.http://h/x?loginpas=SECRET.min_score=0.2"
    run = subprocess.run(
        [sys.executable, "-m", "phdtrack", *words, setting],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "SECRET" not in run.stdout + run.stderr
    for file in (tmp_path / "run").glob("*"):
        assert b"SECRET" not in file.read_bytes()


def test_passwords_come_from_the_environment_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMERA_PASSWORD", "a/b@c #")
    (tmp_path / "user").write_text("me ü\n")
    address = f"rtsp://{{file:{tmp_path}/user}}:{{env:CAMERA_PASSWORD}}@h/live"
    assert filled(address) == "rtsp://me%20%C3%BC:a%2Fb%40c%20%23@h/live"
    check_address(address)
    assert shown(address) == "rtsp://…@h/live"
    with pytest.raises(InputError, match="no variable ABSENT"):
        check_address("rtsp://u:{env:ABSENT}@h/live")
    with pytest.raises(InputError, match=r"file .*absent cannot be read"):
        check_address(f"rtsp://u:{{file:{tmp_path}/absent}}@h/live")
    said = phdtrack("live", "rtsp://u:{env:ABSENT}@h/live", "--out", tmp_path / "out")
    assert "ABSENT" in said.err
    assert said.status == 2
    hook = ["--webhook", "https://u:{env:ABSENT}@h/x"]
    assert phdtrack("live", "0", *hook, "--out", tmp_path / "out").status == 2


def test_a_variable_holds_a_whole_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a unit of systemd: the address of a camera, its number, or the name of a file."""
    monkeypatch.setenv("CAMERA", "rtsp://u:SECRET@h/live")
    assert resolved("{env:CAMERA}") == "rtsp://u:SECRET@h/live"
    assert named_sources(["gate={env:CAMERA}"]) == {"gate": "{env:CAMERA}"}
    assert resolved("a {env:CAMERA}.mp4") == "a {env:CAMERA}.mp4"
    monkeypatch.setenv("CAMERA", "rtsp://u:SE/CRET@h/live")
    with pytest.raises(InputError, match="%2F") as caught:
        check_address("{env:CAMERA}")
    assert "CRET" not in str(caught.value)
    monkeypatch.setenv("CAMERA", str(tmp_path / "none.mp4"))
    with pytest.raises(InputError, match=r"no such file"):
        named_sources(["{env:CAMERA}"])
    with pytest.raises(InputError, match="no variable ABSENT"):
        named_sources(["{env:ABSENT}"])


@pytest.mark.parametrize("character", ["/", "?", "#", " "])
def test_passwords_that_are_not_escaped_are_refused(character: str) -> None:
    with pytest.raises(InputError, match="%2F") as caught:
        check_address(f"rtsp://u:SE{character}CRET@h/live")
    assert "CRET" not in json.dumps(str(caught.value))
