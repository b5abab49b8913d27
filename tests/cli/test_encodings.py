"""Output on terminals and in files that are not UTF-8, and names of files that are unusual."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import duckdb
import numpy as np
import pytest

from phdtrack.cli.app import COMMANDS
from phdtrack.video import VideoWriter

NAMES = [
    b"caf\xe9.mp4",
    b"\xff\xfe.mp4",
    "日本 Straße.mp4".encode(),
    b"a:b.mp4",
    b"[1] x*?.mp4",
    b"-%d#?&.mp4",
    b"x" * 251 + b".mp4",
]


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "street.mp4"
    with VideoWriter(path, 64, 48, 10) as video:
        for k in range(12):
            image = np.full((48, 64, 3), 90, np.uint8)
            image[10:30, 4 * k : 4 * k + 10] = 200
            video.write(image)
    return path


def run(folder: Path, *words: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the command in a process; it must not end with a traceback."""
    done = subprocess.run(
        [sys.executable, "-m", "phdtrack", *map(os.fsencode, map(str, words))],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
        capture_output=True,
        check=False,
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode("utf-8", "replace")
    return done


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["gbk", "cp932", "ascii", "cp1252"])
def test_no_encoding_ends_a_run(clip: Path, tmp_path: Path, encoding: str) -> None:
    zone = "Tür=1,1,63,1,63,47,1,47"
    for words in (
        ["track", clip, "--out", "run"],
        ["count", clip, "--zone", zone, "--out", "counts"],
        ["batch", clip, "--out", "batch"],
        ["settings"],
    ):
        done = run(tmp_path, *words, PYTHONIOENCODING=encoding)
        assert done.returncode == 0
        assert done.stdout.decode(encoding)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_help_and_errors_are_printed(tmp_path: Path, command: str) -> None:
    for words in (["--help"], ["ab…日本\u20ac", "--ab…"]):
        done = run(tmp_path, command, *words, PYTHONIOENCODING="gbk")
        assert done.stdout.decode("gbk") or done.stderr.decode("gbk")


@pytest.mark.slow
def test_json_is_complete_in_any_encoding(clip: Path, tmp_path: Path) -> None:
    zone = "Tür…=1,1,63,1,63,47,1,47"
    words = ["count", clip, "--zone", zone, "--json", "--out"]
    for encoding in ("ascii", "utf-8"):
        done = run(tmp_path, *words, encoding, PYTHONIOENCODING=encoding)
        assert "Tür…" in json.dumps(json.loads(done.stdout), ensure_ascii=False)


@pytest.mark.slow
def test_names_that_the_locale_lacks_are_kept(clip: Path, tmp_path: Path) -> None:
    zone = "Tür=1,1,63,1,63,47,1,47"
    words = ["count", clip, "--zone", zone, "--out", "out"]
    done = run(tmp_path, *words, LC_ALL="C", PYTHONUTF8="0")
    assert done.returncode == 0
    assert "Tür" in (tmp_path / "out" / "counts.csv").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES, ids=lambda name: str(name[:12]))
def test_unusual_names_are_tracked(clip: Path, tmp_path: Path, name: bytes) -> None:
    shutil.copy(clip, os.fsencode(tmp_path) + b"/" + name)
    video = "./" * name.startswith(b"-") + os.fsdecode(name)
    out = os.fsdecode(b"d:" + name[:20])
    assert run(tmp_path, "track", video, "--out", out).returncode == 0
    assert json.loads((tmp_path / out / "run.json").read_bytes())["frames"] == 12
    zone = "door=1,1,63,1,63,47,1,47"
    assert run(tmp_path, "count", video, "--zone", zone, "--out", "count").returncode == 0


@pytest.mark.slow
def test_unusual_names_become_one_data_set(clip: Path, tmp_path: Path) -> None:
    for name in NAMES:
        shutil.copy(clip, os.fsencode(tmp_path) + b"/" + name)
    done = run(tmp_path, "batch", ".", "--out", "batch")
    assert done.returncode == 0, done.stderr
    rows = f"'{tmp_path}/batch/tracks/*.parquet'"
    found = duckdb.sql(f"SELECT DISTINCT filename FROM read_parquet({rows}, filename=true)")
    assert len(list((tmp_path / "batch" / "tracks").glob("*.parquet"))) == len(NAMES)
    assert len(found.fetchall()) <= len(NAMES)


@pytest.mark.slow
def test_printed_settings_are_read_in_other_encodings(tmp_path: Path) -> None:
    text = run(tmp_path, "settings").stdout.decode("utf-8")
    for encoding in ("cp1252", "utf-16"):
        (tmp_path / "s.toml").write_bytes(text.encode(encoding, "replace"))
        assert run(tmp_path, "settings", "--config", "s.toml").returncode == 0
    (tmp_path / "s.toml").write_bytes(b'preset = "T\xfcr"\n')
    assert b"no text" in run(tmp_path, "settings", "--config", "s.toml").stderr
