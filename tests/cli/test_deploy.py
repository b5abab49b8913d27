"""Files that run phdtrack as a service: a compose file, a unit of systemd, the Dockerfile."""

from __future__ import annotations

import configparser
import json
import re
import shlex
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
def test_services_start_a_command_that_exists(words: list[str], tmp_path: Path) -> None:
    """A camera that is not there fails after all options were understood."""
    assert words[0] == "live"
    given = options(words) | {"--host": "127.0.0.1", "--port": "0", "--out": str(tmp_path)}
    camera = f"entrance={tmp_path / 'none.mp4'}"
    result = phdtrack("live", camera, *chain(*given.items()), "--duration", "0.1")
    assert "none.mp4" in result.err
    assert "option" not in result.err.lower()


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
    entry = re.search(r"^ENTRYPOINT (.*)$", docker, re.MULTILINE)[1]
    assert json.loads(entry) == ["phdtrack"]
