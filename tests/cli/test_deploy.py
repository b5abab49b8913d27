"""Files that run phdtrack as a service: a compose file, a unit of systemd, the Dockerfile."""

from __future__ import annotations

import configparser
import json
import re
import shlex
import shutil
import subprocess
import sys
from itertools import chain, pairwise
from pathlib import Path

import pytest
from cli_runner import phdtrack

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"


class _Options(configparser.RawConfigParser):
    """A unit of systemd: names with capitals, some of them repeated."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


def unit() -> dict[str, dict[str, str]]:
    parser = _Options(strict=False, delimiters="=", comment_prefixes="#")
    parser.read(DEPLOY / "phdtrack.service")
    return {name: dict(parser[name]) for name in parser.sections()}


def compose() -> tuple[list[str], str]:
    """The words of the command, and the whole text."""
    text = (DEPLOY / "compose.yaml").read_text(encoding="utf-8")
    block = re.search(r"^    command:\n((?:      - .*\n)+)", text, re.MULTILINE)[1]
    return [line.removeprefix("      - ") for line in block.splitlines()], text


def options(words: list[str]) -> dict[str, str]:
    """The options that are given, with their values."""
    joined = [one for word in words for one in (word.split("=", 1) if word[:2] == "--" else [word])]
    return {name: value for name, value in pairwise(joined) if name[:2] == "--"}


def commands() -> list[list[str]]:
    return [compose()[0], shlex.split(unit()["Service"]["ExecStart"])[1:]]


@pytest.mark.parametrize("words", commands(), ids=["compose", "systemd"])
def test_services_start_a_command_that_exists(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that is not there fails after all options were understood. Its address is no part of
    the command, which every user of the machine can see.
    """
    assert words[0] == "live"
    monkeypatch.setenv("CAMERA", str(tmp_path / "none.mp4"))
    given = options(words) | {"--host": "127.0.0.1", "--port": "0", "--out": str(tmp_path)}
    result = phdtrack("live", words[1], *chain(*given.items()), "--duration", "0.1")
    assert "{env:CAMERA}: there is no such file" in result.err
    assert "option" not in result.err.lower()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    text = (DEPLOY / "phdtrack.service").read_text(encoding="utf-8")
    # The command must exist on the machine that checks.
    copy = tmp_path / "phdtrack.service"
    copy.write_text(re.sub(r"/opt/\S+/phdtrack", sys.executable, text), encoding="utf-8")
    command = ["systemd-analyze", "verify", "--man=no", copy]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # Other units of this machine may have faults of their own.
    said = (done.stdout + done.stderr).splitlines()
    assert not [line for line in said if "phdtrack" in line]


def test_the_unit_restarts_and_may_write_only_its_folders() -> None:
    service = unit()["Service"]
    assert service["Restart"] == "always"
    assert service["ProtectSystem"] == "strict"
    words = shlex.split(service["ExecStart"])
    assert options(words)["--out"] == f"/var/lib/{service['StateDirectory']}"
    assert service["Environment"] == f"NUMBA_CACHE_DIR=/var/cache/{service['CacheDirectory']}"
    assert set(unit()) == {"Unit", "Service", "Install"}


def test_the_container_is_checked_where_it_listens() -> None:
    words, text = compose()
    given = options(words)
    docker = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert f"EXPOSE {given['--port']}" in docker
    assert re.search(r"^USER (?!root)\w+$", docker, re.MULTILINE)
    assert f"http://localhost:{given['--port']}/healthz" in text
    assert given["--allow-host"] == "localhost"
    # Only this machine reaches the page, unless somebody changes that.
    assert f"- 127.0.0.1:{given['--port']}:{given['--port']}" in text
    assert given["--out"].startswith("/work/")
    assert "cameras:/work" in text
    # All other folders are read-only, and the image's kernels are for one kind of processor.
    kept = re.search(r"^ENV NUMBA_CACHE_DIR=(\S+)$", docker, re.MULTILINE)[1]
    assert f"- kernels:{kept}\n" in text
    entry = re.search(r"^ENTRYPOINT (.*)$", docker, re.MULTILINE)[1]
    assert json.loads(entry) == ["phdtrack"]
