"""The pages that ``--help`` prints: plain ASCII text of at most 80 columns.

Options stand in panels, those that most users need first. `_PANELS` arranges the options of all
commands by name; a `HelpPage` has what is special to one command. The words for an option stand
with the option, in the module of its command or in `cli.options`.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from typer.core import TyperCommand, TyperGroup

from phdtrack.cli.options import SOURCE
from phdtrack.conventions import FORMATS

# Columns of a page without the margin, and of the names of options.
_WIDTH = 78
_NAMES = 26
_MORE = "More"
# Panels in the order of the page, and options in that of their panel.
_PANELS = {
    "Lines and zones": "line zone places dwell leave-after",
    "Ground": "camera edges positions",
    "Input": ("detections tracks truth frames fps frame-size size image-size"),
    "Detector": "detector mask max-width learn detect-again",
    "Tracking": (
        "classes filter scene camera-motion appearance reidentify-within preset config set"
    ),
    "Events": "webhook allow-private mqtt home-assistant",
    "Page": "host port page browser allow-host certificate key unhealthy-after",
    "Output": (
        "to out overwrite resume video video-size display snapshots blur quota parquet duration"
        " all json quiet"
    ),
    "File formats": "format first-frame units box sequence labelled on-error",
    _MORE: "seed threads max-detections checkpoint-every max-file-size version help",
}
_SCENE = "Examples (make the scene first: phdtrack simulate street --out street):"
_TRACKED = "phdtrack track --detections street/det/det.txt --out runs/boxes"
_EACH_LINE = (
    "Print a JSON object per line on stdout: each event, and each change of a source's state."
)
_BOXES = "Boxes of your own detector; no other one runs."
_FORMATS = ", ".join(FORMATS)
_FORMAT_ALONE = f"Format of the file, if its content does not show it: {_FORMATS}."


@dataclass(frozen=True, slots=True)
class HelpPage:
    """The page of one command.

    Attributes
    ----------
    examples : commands that work on the simulated street, in this order.
    lead : line above them.
    panels : options in panels of this command, which come first; they stand nowhere else.
    texts : other words for an option; empty for one that is not shown.
    """

    examples: tuple[str, ...]
    lead: str = _SCENE
    panels: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)


_POINTS = r"""printf "148 259 0 0\n493 258 6 0\n441 121 8 14\n198 121 -2 14\n" > points.txt"""
_CALIBRATED = "phdtrack calibrate points.txt --out street.toml --image-size 640x360"
PAGES = {
    "demo": HelpPage(("phdtrack demo", "phdtrack demo --out another --seed 3"), "Examples:"),
    "track": HelpPage(
        ("phdtrack track street/scene.mp4", _TRACKED),
        texts={"video": "Write annotated.mp4, the video with the tracks drawn in, or not."},
    ),
    "count": HelpPage(
        (
            "phdtrack count street/scene.mp4 --line door=320,60,320,360 --out runs/door",
            "phdtrack count street/gt/gt.txt --line gate=200,60,200,360 --out runs/truth",
        ),
        texts={"source": f"{SOURCE} Or the directory of a run, or a file of tracks."},
    ),
    "evaluate": HelpPage(
        (
            _TRACKED,
            "phdtrack evaluate --truth street/gt/gt.txt --tracks runs/boxes/tracks.csv",
            "phdtrack evaluate --truth street/gt/gt.txt --tracks street/gt/gt.txt --errors",
        ),
        panels={
            "Input": "truth tracks ignore frames frame-size kitti",
            "Scores": "iou per-class labelled errors detections worst t-gospa rmse",
        },
        texts={
            "format": (
                f"Format of both files, if their content does not show it: {_FORMATS}. If they"
                " differ, write that of the truth first: kitti,mot17. The same holds for"
                " --first-frame, --units and --box."
            ),
            "frame-size": "Size of the frames in pixels, as 1920x1080, for boxes in shares of it.",
        },
    ),
    "compare": HelpPage(
        (
            "phdtrack compare street --filters pmb,gm-phd --seeds 2",
            "phdtrack compare street --clutter 0,10 --seeds 1 --out runs/clutter",
        ),
        panels={
            "Methods": "filters variant preset config set scene classes appearance seeds clutter",
            "Input": "detections detectors max-width truth labelled",
            "Output": "out overwrite scores iou jobs json quiet",
        },
    ),
    "tune": HelpPage(
        (
            "phdtrack simulate crossing --no-video --out crossing",
            "phdtrack tune street crossing",
            "phdtrack tune street crossing --score IDF1 --out runs/tune-idf1",
            "phdtrack tune street/gt/gt.txt street/det/det.txt --out runs/tune-one",
        ),
        panels={
            "Candidates": "filter preset config set variant score",
            "Input": "detections truth frame-size fps",
            "Output": "out overwrite jobs json quiet",
        },
    ),
    "label": HelpPage(
        (
            "phdtrack label street/scene.mp4 --detections street/det/det.txt",
            "phdtrack label street/scene.mp4 --frames 20 --labeller Ada",
        ),
        panels={
            "Marks": "frames labeller suggest labels import export overwrite",
        },
        texts={
            "detections": _BOXES,
            "format": _FORMAT_ALONE,
            "port": "Port of the page. Default: one that is free, each time the same.",
            "seed": "Seed of the draw of frames.",
        },
    ),
    "learn": HelpPage(
        (
            "phdtrack learn --detections street/det/det.txt --clutter unattended",
            "phdtrack learn street/scene.mp4 --clutter unattended --out moving.scene.json",
        ),
        panels={"Learning": "clutter births labels first last"},
        texts={"detections": _BOXES, "format": _FORMAT_ALONE},
    ),
    "calibrate": HelpPage(
        (
            _POINTS,
            _CALIBRATED,
            "phdtrack calibrate points.txt --overwrite --json",
        ),
        "Examples, with four points of the street that phdtrack simulate renders:",
    ),
    "groups": HelpPage(
        (
            _POINTS,
            _CALIBRATED,
            "phdtrack groups street/scene.mp4 --camera street.toml --out runs/groups",
            "phdtrack groups --detections street/det/det.txt --camera street.toml --json",
        ),
        texts={"video": "Write annotated.mp4 and plan.mp4, or not."},
    ),
    "live": HelpPage(
        (
            "phdtrack live street/scene.mp4 --duration 30",
            "phdtrack live gate=street/scene.mp4 --no-page --json --out runs/gate",
        ),
        texts={
            "json": _EACH_LINE,
            "learn": "Learn where the scene flickers, with a background detector.",
            "appearance": (
                "Tell objects apart by how they look: by their colours, onnx:FILE (a network), or"
                " none (default)."
            ),
            # Refused: a camera has no annotated truth.
            "truth": "",
            "labelled": "",
        },
    ),
    "batch": HelpPage(
        (
            "phdtrack batch street/scene.mp4 street/det/det.txt --out all",
            "phdtrack batch 'street/*.mp4' --out quick -- --no-video --filter gm-phd",
        ),
        panels={"Shares of the work": "jobs segment overlap shard engine address"},
    ),
    "detect": HelpPage(
        (
            "phdtrack detect street/scene.mp4 --out runs/found",
            "phdtrack detect street/scene.mp4 --detector mog2 --out runs/mog2",
        ),
        panels={"Detector": "detector classes mask max-width config set"},
    ),
    "export": HelpPage(
        (
            _TRACKED,
            "phdtrack export runs/boxes --to coco",
            "phdtrack export street/gt/gt.txt --to csv --out truth.csv",
        ),
        texts={
            "format": _FORMAT_ALONE,
            "size": (
                "Size of the frames in pixels, as 1920x1080. Default: that of the run, or from"
                " seqinfo.ini beside the file."
            ),
        },
    ),
    "settings": HelpPage(
        ("phdtrack settings", "phdtrack settings --preset background --all"), "Examples:"
    ),
    "simulate": HelpPage(
        (
            "phdtrack simulate street --out street",
            "phdtrack simulate crowd --frames 200 --clutter 5 --look wave=0.3",
        ),
        "Examples:",
        panels={"Scene": "frames p-detect clutter places jitter set look seed"},
        texts={"video": "Render scene.mp4, or write the truth and the detections alone."},
    ),
    "warm-up": HelpPage(("phdtrack warm-up", "phdtrack warm-up --filter gm-phd"), "Examples:"),
}


class HelpfulCommand(TyperCommand):
    """A command whose help is its page."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the page."""
        formatter.write("\n".join(command_lines(self, ctx)) + "\n")


class HelpfulGroup(TyperGroup):
    """The commands, listed with whole summaries."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the page that lists the commands."""
        formatter.write("\n".join(group_lines(self, ctx)) + "\n")


def group_lines(group: Any, ctx: Any) -> Iterator[str]:
    """The lines of the page that lists the commands of a group."""
    yield f"Usage: {ctx.command_path} COMMAND [OPTIONS]"
    yield ""
    yield from _wrapped(group.help)
    yield from ("", "First steps:")
    yield from ("  phdtrack demo", "  phdtrack track VIDEO", "  phdtrack track --help")
    yield from ("", "Commands, in the order of work:")
    commands = [(name, group.commands[name].help) for name in group.list_commands(ctx)]
    names = max(len(name) for name, _ in commands) + 4
    for name, text in commands:
        yield from _entry(name, text, names)
    yield from ("", "Options:")
    for param in group.get_params(ctx):
        yield from _entry(_label(param), _text(param), _NAMES)


def command_lines(command: Any, ctx: Any) -> Iterator[str]:
    """The lines of the page of a command."""
    page = PAGES.get(command.name, HelpPage(()))
    params = command.get_params(ctx)
    arguments = [param for param in params if param.param_type_name == "argument"]
    yield f"Usage: {ctx.command_path} {_usage(params)}"
    if command.help:
        yield ""
        yield from _wrapped(command.help)
    if page.examples:
        yield from ("", page.lead)
        yield from (f"  {line}" for line in page.examples)
    if arguments:
        yield from ("", "Arguments:")
        for param in arguments:
            text = page.texts.get(param.name) or param.help or ""
            yield from _entry(_argument(param), text, _NAMES)
    options = {_name(param): param for param in params if param not in arguments}
    for title, names in _panels(page, options):
        yield from ("", f"{title}:")
        for name in names:
            yield from _entry(_label(options[name]), _text(options[name], page.texts), _NAMES)


def _panels(page: HelpPage, names: Iterable[str]) -> Iterator[tuple[str, list[str]]]:
    """The panels of a page with their options; what stands in none goes to the last."""
    left = [name for name in names if page.texts.get(name, name)]
    own = {title: _chosen(words, left) for title, words in page.panels.items()}
    left = [name for name in left if not any(name in chosen for chosen in own.values())]
    usual = {title: _chosen(words, left) for title, words in _PANELS.items()}
    known = {name for chosen in usual.values() for name in chosen}
    usual[_MORE] = [*(name for name in left if name not in known), *usual[_MORE]]
    for title in dict.fromkeys([*own, *usual]):
        chosen = [*own.get(title, []), *usual.get(title, [])]
        if chosen:
            yield title, chosen


def _chosen(words: str, names: Sequence[str]) -> list[str]:
    """The names that are among the words, in the order of these."""
    return [word for word in words.split() if word in names]


def _usage(params: Sequence[Any]) -> str:
    """The arguments and required options of a command, as a user types them."""
    words = []
    for param in params:
        if param.param_type_name == "argument":
            word = _argument(param)
            words.append(word if param.required else f"[{word}]")
    words += [
        _label(param) for param in params if param.param_type_name == "option" and param.required
    ]
    return " ".join([*words, "[OPTIONS]"])


def _argument(param: Any) -> str:
    """The name of an argument, with dots if it can be repeated."""
    name = str(param.metavar or param.name.upper())
    if param.nargs == -1 and not name.endswith("..."):
        return f"{name}..."
    return name


def _name(param: Any) -> str:
    """The name of an option without its dashes."""
    return str(max(param.opts, key=len)).lstrip("-")


def _label(param: Any) -> str:
    """The spellings of an option, and what its value is called."""
    names = ", ".join(sorted(param.opts, key=len))
    if param.secondary_opts:
        return f"{names}, {', '.join(param.secondary_opts)}"
    if param.is_flag or not param.metavar:
        return names
    return f"{names} {param.metavar}"


def _text(param: Any, texts: Mapping[str, str] | None = None) -> str:
    """The words for an option, with its default, and that it is needed."""
    text = (texts or {}).get(_name(param)) or param.help or ""
    if not text.endswith((".", ")")):
        text += "."
    if param.required:
        return f"{text} Required."
    default = param.default
    # Versions of click differ in what stands for no default.
    told = isinstance(default, int | float | str | Path) and default is not False and default != ""
    if "default" in text.lower() or not told:
        return text
    if default is True:
        default = param.opts[0]
    if isinstance(default, float):
        default = f"{default:g}"
    return f"{text} Default: {default}."


def _entry(name: str, text: str, names: int) -> Iterator[str]:
    """A name and the words for it in two columns; a long name has a line of its own."""
    lines = _fill(text, _WIDTH - names)
    if len(name) > names - 4:
        yield f"  {name}"
    else:
        yield f"  {name:<{names - 2}}{lines[0]}".rstrip()
        lines = lines[1:]
    yield from (f"{'':{names}}{line}" for line in lines)


def _wrapped(text: str) -> Iterator[str]:
    """Paragraphs of a docstring; one that begins with a backspace keeps its lines."""
    for number, paragraph in enumerate(inspect.cleandoc(text).split("\n\n")):
        if number:
            yield ""
        if paragraph.startswith("\b"):
            yield from (f"  {line.rstrip()}" for line in paragraph.splitlines()[1:])
        else:
            yield from (f"  {line}" for line in _fill(paragraph, _WIDTH - 2))


def _fill(text: str, width: int) -> list[str]:
    """The lines of a text; names with hyphens stay whole, so that they can be searched for."""
    lines = textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)
    return lines or [""]
