"""The command line: ``phdtrack COMMAND`` and ``python -m phdtrack COMMAND``.

Exit status: 0 the job is done; 1 something failed that is not the user's input; 2 the input or the
options cannot be used, with one sentence on stderr; 130 stopped by Ctrl-C, 143 by SIGTERM, 129 by
SIGHUP. With ``--json`` stdout carries exactly one JSON object, and everything else goes to
stderr.
"""

from __future__ import annotations

import functools
import gc
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from phdtrack import __version__
from phdtrack.addresses import shown
from phdtrack.cli import signals
from phdtrack.cli.help_pages import HelpfulCommand, HelpfulGroup, command_lines
from phdtrack.cli.output import use_replacements
from phdtrack.errors import InputError, absent, interrupted

Command = Callable[..., None]

# What each command does, in the order of work. Its module, of the same name except `_MODULES`, is
# loaded when it is run.
COMMANDS = {
    "demo": "Render a street and track the people in it, with the filter and without.",
    "track": "Track the objects in a video, or in a file of detections.",
    "count": (
        "Count who crosses lines and who is in zones: in a video, in a run, or among tracks in a"
        " file."
    ),
    "evaluate": "Score tracks against annotated objects.",
    "compare": "Compare filters: one table, with confidence intervals over seeds.",
    "tune": "Choose settings for your own sequences, and report what the choice is worth.",
    "label": (
        "Mark false detections, missed objects and births on frames drawn at random: the page says"
        " how."
    ),
    "learn": (
        "Learn where people enter and where the detector is wrong, for `phdtrack track --scene`."
    ),
    "calibrate": (
        "Make a camera of four or more points of flat ground, and report how well it fits each of"
        " them."
    ),
    "groups": "Find groups of people on the ground, in a video or in a file of detections.",
    "live": "Track cameras without end: events, rows and videos by the hour, and a page.",
    "batch": (
        "Track many videos: by processes, the jobs of an array, or a Ray cluster, into one data"
        " set."
    ),
    "detect": "Detect objects in a video and write detections.csv, a MOTChallenge file.",
    "export": "Write the tracks of a run, or of a file, in the format of another tool.",
    "settings": "Print settings as TOML, with units and meaning, for --config to read back.",
    "simulate": "Simulate a scene: truth, detections of it, and a video.",
    "warm-up": "Compile the kernels in advance, for example while a Docker image is built.",
}
# Seconds after which a thread gives the interpreter to one that waits: the threads of a run need it
# often, each time briefly.
_SWITCH = 1e-5
# Containers made after which the interpreter looks for garbage, 700 by default: loading modules and
# kernels makes hundreds of thousands that stay, and looking through them took a tenth of the time.
_GARBAGE = 5_000
# What versions of typer call a kind of number, and its name here.
_NUMBERS = {"integer": "a whole number", "number": "a number", "float": "a number"}
_MODULES = {"demo": "simulate", "settings": "show_settings", "warm-up": "warm_up"}
_SUMMARY = (
    "From a video, or any detector's boxes, to tracks: a filter of random finite sets between"
    " detector and identities."
)


def application(name: str) -> typer.Typer:
    """The command line with the command ``name`` loaded, and the other commands' help."""
    app = typer.Typer(
        name="phdtrack",
        cls=HelpfulGroup,
        help=_SUMMARY,
        # Plain text: an error is one line that a program can find and a terminal does not break.
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(help=_SUMMARY)(common)
    for each, what in COMMANDS.items():
        if each == name:
            module = import_module(f"phdtrack.cli.{_MODULES.get(name, name)}")
            app.command(each, cls=_Passing if each == "batch" else HelpfulCommand)(
                with_options(guarded(getattr(module, each.replace("-", "_"))))
            )
        else:
            app.command(each, help=what)(lambda: None)
    return app


class _Passing(TyperCommand):
    """A command that finds what follows ``--`` in ``args`` of its context."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        formatter.write("\n".join(command_lines(self, ctx)) + "\n")

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if "--" in args:
            end = args.index("--")
        else:
            end = len(args)
        rest = super().parse_args(ctx, args[:end])
        ctx.args = args[end + 1 :]
        return rest


def guarded(command: Command) -> Command:
    """The command with its errors printed as one sentence and turned into an exit status."""

    @functools.wraps(command)
    def run(**options: Any) -> None:
        try:
            command(**options)
        except InputError as error:
            raise failed(str(error), 2) from error
        except ModuleNotFoundError as error:
            raise failed(str(absent(error)), 2) from error
        except (KeyboardInterrupt, SystemError) as error:
            if not interrupted(error):
                raise
            raise failed("stopped", signals.status()) from error
        except BrokenPipeError:
            # The reader of our output has gone (phdtrack ... | head): nothing can be printed.
            raise
        except OSError as error:
            if error.filename:
                where = f"{error.filename}: "
            else:
                where = ""
            raise failed(f"{where}{error.strerror or error}", 1) from error

    return run


def with_options(command: Command) -> Command:
    """The command with the fields of each record among its parameters as options of their own."""
    parameters = inspect.signature(command, eval_str=True).parameters
    records: dict[str, Any] = {
        name: one.annotation for name, one in parameters.items() if is_dataclass(one.annotation)
    }
    options = list[inspect.Parameter]()
    for name, parameter in parameters.items():
        options += _options_of(records[name]) if name in records else [parameter]
    options = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in options]

    def run(**values: Any) -> None:
        made = {name: _record(kind, values) for name, kind in records.items()}
        command(**values, **made)

    run.__doc__ = command.__doc__
    run.__annotations__ = {one.name: one.annotation for one in options}
    # Read by `inspect.signature`, and so by typer.
    run.__dict__["__signature__"] = inspect.Signature(options)
    return run


def _options_of(record: Any) -> list[inspect.Parameter]:
    """The fields of a record, and of the records in it, as options.

    The requests of phdtrack.run are plain records: their options stand in `REQUESTS`.
    """
    from phdtrack.cli.options import REQUESTS

    annotations = REQUESTS.get(record, {})
    options = list[inspect.Parameter]()
    for one in inspect.signature(record, eval_str=True).parameters.values():
        if is_dataclass(one.annotation):
            options += _options_of(one.annotation)
        else:
            options.append(one.replace(annotation=annotations.get(one.name, one.annotation)))
    return options


def _record(record: Any, values: dict[str, Any]) -> Any:
    """The record made of the values of its options, which are taken out."""
    fields = inspect.signature(record, eval_str=True).parameters.values()
    return record(
        **{
            one.name: _record(one.annotation, values)
            if is_dataclass(one.annotation)
            else values.pop(one.name)
            for one in fields
        }
    )


def parser(command: Command, name: str) -> Any:
    """The command alone, to be called with words of a command line, with the help of ``name``."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name, cls=HelpfulCommand)(with_options(command))
    return typer.main.get_command(app)


def failed(sentence: str, status: int) -> typer.Exit:
    """Print the sentence on stderr, without secrets, and give the exit to raise."""
    print(f"phdtrack: {shown(sentence)}", file=sys.stderr)
    return typer.Exit(status)


def version(wanted: bool) -> None:
    """Print the version and stop, for ``--version``."""
    if wanted:
        print(f"phdtrack {__version__}")
        raise typer.Exit


def common(
    wanted: Annotated[
        bool, typer.Option("--version", callback=version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Hold the options of all commands."""


# The error that typer raises for a command line that cannot be read. Some versions have a click of
# their own, others import it.
Misuse: type[Any] = typer.BadParameter.__bases__[0]


def _in_own_words(sentence: str, words: Sequence[str]) -> str:
    """The sentence about a word that is no number, whichever version of typer wrote it, as those of
    other wrong values.

    Parameters
    ----------
    sentence : of a command line that cannot be read.
    words : of this line.
    """
    match = re.match(r"(Invalid value for '(?:-\w, )?(--[\w-]+)').*valid (\w+)", sentence)
    if match is None or match[3] not in _NUMBERS:
        return sentence
    values = [
        word.removeprefix(f"{match[2]}=") if word.startswith(f"{match[2]}=") else after
        for word, after in zip(words, [*words[1:], ""], strict=True)
        if word.partition("=")[0] == match[2]
    ]
    if not values:
        return sentence
    return f"{match[1]}: expected {_NUMBERS[match[3]]}, got {values[-1]!r}"


def main() -> None:
    """The entry point of the installed command."""
    words = sys.argv[1:] or ["--help"]
    name = words[0]
    if "_PHDTRACK_COMPLETE" in os.environ:
        # A shell asks for completions of the line that is here; bash under the second name.
        line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")
        name = "".join(line.split()[1:2])
    sys.setswitchinterval(_SWITCH)
    gc.set_threshold(_GARBAGE)
    use_replacements()
    try:
        # A signal may arrive before this has returned.
        signals.listen()
        status = application(name)(words, prog_name="phdtrack", standalone_mode=False)
        if status == 130 != signals.status():
            # While the command line was read: Typer takes every signal for Ctrl-C.
            raise KeyboardInterrupt
    except Misuse as error:
        # One sentence for a command line that cannot be read, and where its help stands.
        where = getattr(error, "ctx", None)
        sentence = _in_own_words(" ".join(error.format_message().split()), words)
        if sentence.endswith((".", "?")):
            end = ""
        else:
            end = "."
        status = failed(
            f"{sentence}{end} See {where.command_path if where else 'phdtrack'} --help.", 2
        ).exit_code
    except KeyboardInterrupt:
        # While a command was loaded.
        status = failed("stopped", signals.status()).exit_code
    signals.leave(int(status or 0))
