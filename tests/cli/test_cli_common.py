"""What holds for the command line as a whole: start-up, entry points, usage errors, exit
statuses.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import pytest
import typer
from cli_runner import phdtrack, walkers
from typer.testing import CliRunner

from phdtrack import __version__
from phdtrack.cli.app import COMMANDS, application, guarded
from phdtrack.cli.output import Output
from phdtrack.config.presets import PRESETS
from phdtrack.errors import InputError
from phdtrack.run.choices import chosen_settings
from phdtrack.run.requests import TrackingRequest
from programs import finished


def run(
    *command: str, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    known = os.environ | (environment or {})
    return subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=False, env=known
    )


def test_help_names_every_command_and_starts_quickly() -> None:
    times = []
    for _ in range(3):
        start = time.perf_counter()
        done = run(sys.executable, "-m", "phdtrack", "--help")
        times.append(time.perf_counter() - start)
        assert done.returncode == 0
        assert all(command in done.stdout for command in COMMANDS)
    # It takes 0.2 s; the rest is for machines that do something else at the time.
    assert min(times) < 1.0


def test_settings_are_printed_as_a_file_that_config_reads(tmp_path: Path) -> None:
    said = phdtrack(
        "settings",
        "--preset",
        "m09",
        "--filter",
        "gm-phd",
        "--set",
        "sensor.detection_probability=0.7",
    )
    assert "detection_probability = 0.7  # probability p_D that a target is detected" in said.out
    (tmp_path / "mine.toml").write_text(said.out, encoding="utf-8")
    again = phdtrack("settings", "--config", tmp_path / "mine.toml", "--all", "--json").object
    assert (again["preset"], again["filter"]["kind"], again["sensor"]["detection_probability"]) == (
        "m09",
        "gm-phd",
        0.7,
    )
    assert len(said.out.splitlines()) < 40


def test_both_entry_points_are_the_same() -> None:
    script = Path(sys.executable).with_name("phdtrack")
    assert script.exists()
    for command in ([str(script)], [sys.executable, "-m", "phdtrack"]):
        done = run(*command, "--version")
        assert (done.returncode, done.stdout.strip()) == (0, f"phdtrack {__version__}")


def asked_by_shells(line: str) -> tuple[dict[str, str], dict[str, str]]:
    """The environments in which bash and zsh ask for the completions of a line."""
    bash = {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    zsh = {"_TYPER_COMPLETE_ARGS": line}
    return (
        bash | {"_PHDTRACK_COMPLETE": "complete_bash"},
        zsh | {"_PHDTRACK_COMPLETE": "complete_zsh"},
    )


def test_shells_ask_the_program_itself() -> None:
    bash, zsh = asked_by_shells("phdtrack track --filter gm")
    done = run(sys.executable, "-m", "phdtrack", environment=bash)
    assert (done.returncode, done.stdout.split()) == (0, ["gm-phd", "gm-cphd"])
    done = run(sys.executable, "-m", "phdtrack", environment=zsh)
    assert done.returncode == 0
    assert all(f'"{word}"' in done.stdout for word in ("gm-phd", "gm-cphd"))


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("phdtrack tra", ["track"]),
        ("phdtrack track --pres", ["--preset"]),
        ("phdtrack export --t", ["--to"]),
        ("phdtrack export run --to c", ["csv", "coco", "cvat"]),
        ("phdtrack track --filter gm", ["gm-phd", "gm-cphd"]),
        ("phdtrack track --detector m", ["mean-background", "mog2"]),
        ("phdtrack track --preset m0", ["m07", "m07-extended", "m09", "m09-extended", "m09-mht"]),
        ("phdtrack x", []),
    ],
)
def test_a_shell_completes_commands_their_options_and_names(line: str, found: list[str]) -> None:
    bash, zsh = asked_by_shells(line)
    program = application(line.split()[1])
    done = CliRunner().invoke(program, [], prog_name="phdtrack", env=bash)
    assert (done.exit_code, done.stdout.split()) == (0, found)
    done = CliRunner().invoke(program, [], prog_name="phdtrack", env=zsh)
    assert done.exit_code == 0
    assert all(f'"{word}"' in done.stdout for word in found)


def test_the_lines_that_a_shell_needs_are_printed() -> None:
    # Which shell it is for is the one that asks.
    done = run("bash", "-c", f"{shlex.quote(sys.executable)} -m phdtrack --show-completion && true")
    assert done.returncode == 0, done.stderr
    assert "_PHDTRACK_COMPLETE=complete_bash" in done.stdout


def test_quiet_says_warnings_only(tmp_path: Path) -> None:
    detections = walkers(tmp_path / "walkers", seqinfo=False) / "det" / "det.txt"
    detections.write_text(detections.read_text() + "3,-1,5000,60,24,60,1,-1,-1,-1\n")
    words = (
        "track",
        "--detections",
        detections,
        "--frame-size",
        "320x240",
        "--fps",
        25,
        "--out",
        tmp_path / "run",
    )
    said = phdtrack(*words, "--quiet")
    assert (said.status, said.out) == (0, "")
    assert said.err.count("\n") == said.err.count("phdtrack: warning: ") > 0
    assert (tmp_path / "run" / "report.html").exists()
    said = phdtrack(*words, "--overwrite", "--quiet", "--json")
    assert said.object["complete"] is True
    assert "report.html" in phdtrack(*words, "--overwrite").out


def test_quiet_shows_no_progress(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown = []
    for quiet in (True, False):
        with Output(quiet=quiet).progress("tracking", 10) as advance:
            advance(3, total=5, description="drawing")
        shown.append("tracking" in capsys.readouterr().err)
    assert shown == [False, True]


def test_progress_has_plain_lines_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with Output().progress("tracking") as advance, Output().progress("drawing") as inner:
        for done in range(1, 101):
            now[0] += 1.0
            advance(done, total=200, description="learning the background (1 of 2)")
            inner(done)
    printed = capsys.readouterr().err.splitlines()
    first = "phdtrack: learning the background (1 of 2)"
    assert printed == [f"{first} {done}/200" for done in (30, 60, 90)]
    with Output(quiet=True).progress("tracking") as advance:
        now[0] += 100.0
        advance(7)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_says_what_it_does(command: str) -> None:
    """The one sentence of the list of commands begins the help of the command."""
    said = phdtrack(command, "--help")
    assert said.status == 0
    assert COMMANDS[command].split(",")[0].split(":")[0].rstrip(".") in " ".join(said.out.split())
    # Click writes UTF-8 to a terminal of any encoding: only ASCII is read everywhere.
    assert said.out.isascii()


def test_presets_in_the_help_are_all_there_are() -> None:
    said = " ".join(phdtrack("track", "--help").out.split()).replace("- ", "-")
    for preset in PRESETS:
        assert re.search(rf"(?<![\w-]){preset}[,.]", said)


def test_help_of_track_shows_how_to_export_a_network() -> None:
    lines = phdtrack("track", "--help").out.splitlines()
    at = lines.index("    yolo export model=yolo11n.pt format=onnx")
    assert "--detector onnx:yolo11n.onnx --classes person,car" in lines[at + 1]
    assert "moving regions are tracked: counts are approximate" in " ".join(
        " ".join(lines[:at]).split()
    )


def test_the_help_of_live_says_when_a_camera_is_unhealthy() -> None:
    assert "--unhealthy-after" in phdtrack("live", "--help").out


@pytest.mark.parametrize(
    "arguments",
    [
        ["trak"],
        ["track", "--detektor", "x"],
        ["track", "v.mp4", "--seed", "-1"],
        ["evaluate", "--iou", "x"],
    ],
)
def test_usage_errors_are_status_2_without_a_traceback(arguments: list[str]) -> None:
    done = run(sys.executable, "-m", "phdtrack", *arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("phdtrack: ")
    assert done.stderr.count("\n") == 1
    assert done.stderr.endswith(" --help.\n")
    assert any(argument in done.stderr for argument in arguments)


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (
            InputError("expected this, got that", where="det.txt, line 3"),
            2,
            "det.txt, line 3: expected this, got that",
        ),
        (KeyboardInterrupt(), 130, "stopped"),
        (
            FileNotFoundError(2, "No such file or directory", "a.mp4"),
            1,
            "a.mp4: No such file or directory",
        ),
        (OSError(28, "No space left on device"), 1, "No space left on device"),
    ],
)
def test_errors_become_a_sentence_and_a_status(
    error: BaseException, status: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise error

    with pytest.raises(typer.Exit) as exit_:
        guarded(command)()
    assert exit_.value.exit_code == status
    captured = capsys.readouterr()
    assert captured.err.strip() == f"phdtrack: {words}"
    assert captured.out == ""


def test_a_reader_that_goes_away_is_no_error() -> None:
    done = run("bash", "-c", f"{sys.executable} -m phdtrack settings --all | head -1")
    assert done.stdout.startswith("# Presets: ")
    assert "Traceback" not in done.stderr


# Not pydantic: newer versions of typer load it themselves.
HEAVY = {"numpy", "scipy", "numba", "cv2", "av", "matplotlib", "rich", "pyarrow"}
# What nobody needs for tracking, whoever brought it along.
NEVER = {
    "scipy.optimize",
    "scipy.stats",
    "scipy.spatial",
    "scipy.ndimage",
    "sklearn",
    "torch",
    "pandas",
    "stonesoup",
    "PIL",
}


def modules(program: str, *arguments: object) -> list[str]:
    """What the program prints, line by line, in a fresh process in which ``sys`` is imported."""
    return finished(f"import sys\n{program}", *map(str, arguments)).stdout.splitlines()


def test_nothing_heavy_is_imported_before_a_command_runs() -> None:
    loaded = modules("import phdtrack.cli.app\nprint(*sys.modules, sep='\\n')")
    assert "phdtrack" in loaded
    assert HEAVY.isdisjoint(loaded)


@pytest.mark.slow
def test_tracking_detections_loads_what_it_needs(tmp_path: Path) -> None:
    begun = modules("import phdtrack.cli.track\nprint(*sys.modules, sep='\\n')")
    # Pictures come with the report, and scores where there is truth; neither is waited for before
    # the first frame.
    assert {"matplotlib", "av", "rich", "phdtrack.metrics", "pyarrow", *NEVER}.isdisjoint(begun)
    table = walkers(tmp_path / "walkers", frames=8) / "det" / "det.txt"
    program = (
        "from phdtrack.cli.app import main\ntry:\n    main()\nfinally:\n    print(*sys.modules,"
        " sep='\\n')"
    )
    done = modules(program, "track", "--detections", table, "--out", tmp_path / "run", "--json")
    assert {"phdtrack.filters", "phdtrack.report.pages"} <= set(done)
    # What the report and the joining of tracks need is loaded beside the tracking.
    late = modules(
        "import scipy.optimize, scipy.sparse.csgraph, matplotlib.figure\nprint(*sys.modules,"
        " sep='\\n')"
    )
    assert {"phdtrack.metrics", *(NEVER - {*late})}.isdisjoint(done)


@pytest.mark.parametrize(
    ("options", "detector", "preset"),
    [
        (TrackingRequest(), "change", "background"),
        (TrackingRequest(), "", "default"),
        (TrackingRequest(), "onnx:net.onnx", "default"),
        (TrackingRequest(preset="default"), "change", "default"),
        (TrackingRequest(filter_name="gm-phd"), "change", "background-other-filters"),
        (TrackingRequest(sets=["filter.kind=mht"]), "change", "background-other-filters"),
        (TrackingRequest(sets=["motion.kind=plane"]), "change", "ground"),
        (TrackingRequest(sets=["sensor.box_noise=0.2"]), "change", "background"),
    ],
)
def test_own_detectors_have_the_preset_for_noisy_boxes(
    options: TrackingRequest, detector: str, preset: str
) -> None:
    assert chosen_settings(options, detector=detector).preset == preset
