"""The help of the command line: panels, whole sentences, and examples that work."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
import typer
from cli_runner import phdtrack

from phdtrack.cli.app import COMMANDS, application
from phdtrack.cli.help_pages import PAGES

PANELS = ("Input", "Detector", "Tracking", "Output", "File formats", "More")
ROOT = Path(__file__).resolve().parents[2]
# What internal notation of ranges and defaults looks like.
NOTATION = re.compile(r"\[default|\[required|x[<>]=|<=x|<str>|<int>|<path>|list\[")


def parsed(name: str) -> Any:
    """The command of this name, with its options."""
    return typer.main.get_command(application(name)).commands[name]


def page(name: str) -> str:
    said = phdtrack(name, "--help")
    assert said.status == 0
    return said.out


def panels(text: str) -> dict[str, list[str]]:
    """The options of each panel of a page, in its order."""
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        if re.fullmatch(r"[A-Z][a-z ]+:", line):
            title = line[:-1]
        elif match := re.match(r"  (?:-h, )?--([\w-]+)", line):
            found.setdefault(title, []).append(match[1])
    return found


def option_names(command: Any) -> set[str]:
    return {
        name
        for param in command.params
        if param.param_type_name == "option"
        for name in (*param.opts, *param.secondary_opts)
    }


def words_of(example: str) -> list[str]:
    """The words after ``phdtrack COMMAND``."""
    return shlex.split(example)[2:]


def test_help_says_what_detectors_and_windows_cost() -> None:
    text = " ".join(page("track").split())
    assert "person (takes about thirty times as long as change), or onnx:FILE" in text
    assert "Needs OpenCV with windows (opencv-python); the headless package has none." in text
    assert "With --appearance: seconds within which a lost object" in text


@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_is_plain_and_fits_a_terminal(name: str) -> None:
    text = page(name)
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 80
    assert NOTATION.findall(text) == []
    # Only what can be repeated has dots: no list is left open.
    assert re.findall(r"(?<!SOURCE)(?<!SEQUENCE)\.\.\.", text) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_stands_in_a_panel_once(name: str) -> None:
    found = panels(page(name))
    listed = [option for names in found.values() for option in names]
    assert len(listed) == len(set(listed))
    every = {
        param.opts[0].lstrip("-") for param in parsed(name).params if "--" in param.opts[0]
    } - ({"truth", "labelled"} if name == "live" else set())
    # `calibrate` has an option of two names.
    assert every <= {*listed}
    usual = [title for title in found if title in PANELS]
    assert usual[-1] == "More"
    # The last panel holds what few users need: nothing falls into it unasked.
    rare = {"seed", "threads", "max-detections", "checkpoint-every", "max-file-size", "help"}
    assert set(found["More"]) <= rare


@pytest.mark.parametrize("name", ["track", "live", "count", "groups", "learn"])
def test_panels_come_in_one_order(name: str) -> None:
    usual = [title for title in panels(page(name)) if title in PANELS]
    assert usual == [title for title in PANELS if title in usual]
    assert set(PANELS) - {*usual} <= {"Input", "File formats"}


def test_options_of_track_begin_with_those_of_most_use() -> None:
    found = panels(page("track"))
    assert {title: names[0] for title, names in found.items()} == {
        "Input": "detections",
        "Detector": "detector",
        "Tracking": "classes",
        "Output": "out",
        "File formats": "format",
        "More": "seed",
    }
    assert found["Input"] == ["detections", "truth", "frames", "fps", "frame-size"]


@pytest.mark.parametrize("name", COMMANDS)
def test_conventions_of_files_have_a_panel_near_the_end(name: str) -> None:
    found = panels(page(name))
    conventions = {"format", "first-frame", "units", "box", "sequence", "on-error"}
    if conventions & {option for names in found.values() for option in names}:
        assert [*found][-2:] == ["File formats", "More"]
        assert conventions & {*found.pop("File formats")}
        assert not conventions & {option for names in found.values() for option in names}


def test_help_names_no_file_of_the_sources() -> None:
    """What pip installs has no folder docs: pages are named by their titles."""
    for name in COMMANDS:
        assert "docs/" not in page(name)
    title = (ROOT / "docs" / "how-to" / "own-detector.md").read_text("utf-8").partition("\n")[0]
    assert f'The page "{title[2:]}" of the documentation' in " ".join(page("track").split())


def test_help_says_how_to_look_at_a_preset() -> None:
    text = " ".join(page("track").split())
    assert "or fv. `phdtrack settings --preset NAME` shows one." in text
    assert phdtrack("settings", "--preset", "fv").status == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_have_options_that_exist(name: str) -> None:
    own = [line for line in PAGES[name].examples if line.startswith(f"phdtrack {name}")]
    assert len(own) >= 2
    text = page(name)
    for example in PAGES[name].examples:
        assert f"  {example}\n" in text
        if not example.startswith("phdtrack "):
            continue
        other = shlex.split(example)[1]
        command = parsed(other)
        options = {word for word in words_of(example.partition(" -- ")[0]) if word[:2] == "--"}
        assert options <= option_names(command)
        # The parser reads the whole line, and refuses values that are none.
        command.make_context(other, words_of(example))


@pytest.mark.slow
def test_examples_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the scene that they say, in the order of the commands; the pages of `label` have no
    end.
    """
    monkeypatch.chdir(tmp_path)
    done = set[str]()
    lines = [PAGES["simulate"].examples[0]]
    lines += [line for name in COMMANDS if name != "label" for line in PAGES[name].examples]
    for line in lines:
        if line in done:
            continue
        done.add(line)
        if line.startswith("printf"):
            quoted, _, file = line.removeprefix("printf ").partition(" > ")
            Path(file).write_text(quoted.strip('"').replace("\\n", "\n"))
            continue
        words = shlex.split(line)[1:]
        if words[:2] == ["simulate", "street"]:
            words += ["--frames", "150", "--set", "lead_in=-6"]
        if words[0] == "live" and "--duration" not in words:
            words += ["--duration", "2"]
        said = phdtrack(*words)
        assert said.status == 0, (line, said.err)
        assert not said.err.startswith("phdtrack: warning: left out"), said.err
    shutil.rmtree(tmp_path / "street")


def test_commands_are_listed_whole_in_the_order_of_work() -> None:
    said = phdtrack("--help")
    assert said.out.isascii()
    assert max(map(len, said.out.splitlines())) <= 80
    assert "..." not in said.out
    listed = said.out.partition("order of work:\n")[2].partition("\n\n")[0]
    assert re.findall(r"^  ([a-z-]+)", listed, re.MULTILINE) == list(COMMANDS)
    first = ["demo", "track", "count", "evaluate", "compare", "tune", "label"]
    assert list(COMMANDS)[:7] == first
    flat = " ".join(listed.split())
    for name, summary in COMMANDS.items():
        assert f"{name} {summary}" in flat


def test_options_of_a_batch_have_the_help_of_track() -> None:
    said = phdtrack("batch", "a.mp4", "--out", "all", "--", "--help")
    assert said.status == 0, said.err
    expected = panels(page("track"))
    # Processes side by side, or on other machines, have no windows.
    expected["Output"].remove("display")
    assert panels(said.out) == expected


def test_count_has_the_options_of_track() -> None:
    missing = option_names(parsed("track")) - option_names(parsed("count"))
    assert missing == {"--no-video", "--video-size"}
    assert "in place of annotated.mp4" in " ".join(page("count").split())


def test_help_of_live_says_what_json_prints() -> None:
    text = " ".join(page("live").split())
    assert "--json Print a JSON object per line on stdout: each event, and each change" in text
    assert "--truth" not in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("track", "v.mp4", "--seed", "-1"), "expected at least 0, got -1"),
        (("track", "v.mp4", "--max-detections", "0"), "expected at least 1, got 0"),
        (("live", "v.mp4", "--video", "100"), "expected 0 to 60, got 100"),
    ],
)
def test_ranges_are_said_in_words(words: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(typer.BadParameter) as error:
        parsed(words[0]).make_context(words[0], list(words[1:]))
    assert error.value.format_message().endswith(sentence)
    assert "at least 1" in " ".join(page("track").split())
    assert "at most 60" in " ".join(page("live").split())
