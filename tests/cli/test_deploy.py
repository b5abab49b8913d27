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
from typing import Any

import pytest
from cli_runner import phdtrack
from ruamel.yaml import YAML

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


def compose() -> dict[str, Any]:
    """The compose file."""
    return YAML(typ="safe", pure=True).load(DEPLOY / "compose.yaml")


def container() -> dict[str, Any]:
    """The service of the compose file that watches the cameras."""
    return compose()["services"]["cameras"]


def instruction(name: str) -> str:
    """The last instruction of this name in the Dockerfile."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    return re.findall(rf"^{name} (.*)$", text, re.MULTILINE)[-1]


def options(words: list[str]) -> dict[str, str]:
    """The options that are given, with their values."""
    joined = [one for word in words for one in (word.split("=", 1) if word[:2] == "--" else [word])]
    return {name: value for name, value in pairwise(joined) if name[:2] == "--"}


def commands() -> list[list[str]]:
    return [container()["command"], shlex.split(unit()["Service"]["ExecStart"])[1:]]


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


def test_the_unit_compiles_kernels_first_and_gives_up_on_errors() -> None:
    service = unit()["Service"]
    before = shlex.split(service["ExecStartPre"])
    assert before[0] == shlex.split(service["ExecStart"])[0]
    assert before[1] == "warm-up"
    assert service["RestartPreventExitStatus"] == "2"
    assert service["UMask"] == "0027"
    text = (DEPLOY / "phdtrack.service").read_text(encoding="utf-8")
    assert "extras\n# opencv, video and web" in text


def test_the_container_compiles_kernels_first() -> None:
    """In a service that ends, with the same kernels and no more rights."""
    first = compose()["services"]["warm-up"]
    service = container()
    assert service["depends_on"] == {"warm-up": {"condition": "service_completed_successfully"}}
    assert first["command"][0] == "warm-up"
    assert first["volumes"] == [one for one in service["volumes"] if one.startswith("kernels:")]
    for name in ("build", "image", "read_only", "tmpfs", "security_opt", "cap_drop"):
        assert first[name] == service[name]


def test_the_log_of_the_container_is_bounded() -> None:
    options = container()["logging"]["options"]
    assert set(options) == {"max-size", "max-file"}


def test_the_container_is_built_from_this_folder() -> None:
    service = container()
    assert (DEPLOY / service["build"] / "Dockerfile").resolve() == ROOT / "Dockerfile"
    assert service["image"] == "phdtrack"
    assert json.loads(instruction("ENTRYPOINT")) == ["phdtrack"]


def test_the_camera_is_required_and_not_in_the_command() -> None:
    service = container()
    address = service["environment"]["CAMERA"]
    assert address.startswith("${CAMERA:?")
    assert [word for word in service["command"] if "CAMERA" in word] == ["entrance={env:CAMERA}"]


def test_the_container_is_checked_where_it_listens() -> None:
    service = container()
    given = options(service["command"])
    assert instruction("EXPOSE") == given["--port"]
    assert given["--allow-host"] == "localhost"
    check = service["healthcheck"]["test"]
    assert check[:3] == ["CMD", "python", "-c"]
    compile(check[3], "healthcheck", "exec")
    assert re.findall(r'urlopen\("(.*?)"', check[3]) == [
        f"http://localhost:{given['--port']}/healthz"
    ]
    # The check itself gives up before the container is taken for hanging.
    allowed = float(re.search(r"timeout=([\d.]+)", check[3])[1])
    assert allowed < float(service["healthcheck"]["timeout"].removesuffix("s"))


def test_only_this_machine_reaches_the_page() -> None:
    service = container()
    port = options(service["command"])["--port"]
    assert service["ports"] == [f"127.0.0.1:{port}:{port}"]
    assert "network_mode" not in service


def test_the_container_keeps_results_and_kernels() -> None:
    """All other folders are read-only, and the image's kernels are for one kind of processor."""
    service = container()
    volumes = dict(one.split(":") for one in service["volumes"])
    assert set(volumes) == set(compose()["volumes"]) == {"cameras", "kernels"}
    assert options(service["command"])["--out"].startswith(f"{volumes['cameras']}/")
    assert instruction("ENV") == f"NUMBA_CACHE_DIR={volumes['kernels']}"
    assert service["read_only"] is True
    assert service["tmpfs"] == "/tmp"


def test_the_container_runs_without_rights() -> None:
    service = container()
    user = service.get("user", instruction("USER"))
    assert re.fullmatch(r"(?!root\b|0\b)\w+(:\w+)?", str(user))
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "privileged" not in service


def test_the_container_restarts_and_has_time_to_end() -> None:
    service = container()
    assert service["restart"] == "unless-stopped"
    assert service["stop_grace_period"] == "30s"
