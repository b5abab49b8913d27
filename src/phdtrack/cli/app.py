"""The command line: ``phdtrack COMMAND`` and ``python -m phdtrack COMMAND``.

Exit status: 0 the job is done; 1 something failed that is not the user's input (`doctor`: something essential does not
work here); 2 the input or the options cannot be used, said in one sentence on stderr; 130 stopped by Ctrl-C.
With ``--json`` stdout carries exactly one JSON object, and everything else goes to stderr.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Annotated, Any, ParamSpec

import typer

from phdtrack import __version__
from phdtrack.cli import calibrate, compare, doctor, evaluate, groups, label, learn, settings, simulate, track
from phdtrack.errors import InputError, interrupted

P = ParamSpec("P")

app = typer.Typer(
    name="phdtrack",
    help="From a video, or any detector's boxes, to tracks: a filter of random finite sets between detector and identities.",
    add_completion=False,
    # Plain text: an error is one line that a program can find and a terminal does not break.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """The command with its errors said in one sentence and turned into an exit status."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except InputError as error:
            raise failed(str(error), 2) from error
        except KeyboardInterrupt as error:
            raise failed("stopped", 130) from error
        except SystemError as error:
            if interrupted(error):
                raise failed("stopped", 130) from error
            raise
        except BrokenPipeError:
            # The reader of our output has gone (phdtrack ... | head): nothing can be said.
            raise
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            raise failed(f"{where}{error.strerror or error}", 1) from error

    return run


def failed(sentence: str, status: int) -> typer.Exit:
    """The sentence on stderr; the exit to raise."""
    print(f"phdtrack: {sentence}", file=sys.stderr)
    return typer.Exit(status)


def version(wanted: bool) -> None:
    """``--version``: print it and stop."""
    if wanted:
        print(f"phdtrack {__version__}")
        raise typer.Exit


@app.callback()
def common(
    wanted: Annotated[bool, typer.Option("--version", callback=version, is_eager=True, help="Print the version.")] = False,
) -> None:
    """From a video, or any detector's boxes, to tracks: a filter of random finite sets between detector and identities."""


app.command("demo")(guarded(simulate.demo))
app.command("track")(guarded(track.track))
app.command("groups")(guarded(groups.groups))
app.command("detect")(guarded(track.detect))
app.command("evaluate")(guarded(evaluate.evaluate))
app.command("compare")(guarded(compare.compare))
app.command("simulate")(guarded(simulate.simulate))
app.command("label")(guarded(label.label))
app.command("learn")(guarded(learn.learn))
app.command("calibrate")(guarded(calibrate.calibrate))
app.command("settings")(guarded(settings.settings))
app.command("doctor")(guarded(doctor.doctor))


# What typer raises for a command line that cannot be read. Some versions bring a click of their own, others import it.
Misuse: type[Exception] = typer.BadParameter.__bases__[0]


def main() -> None:
    """The entry point of the installed command."""
    try:
        status = app(sys.argv[1:] or ["--help"], prog_name="phdtrack", standalone_mode=False)
    except Misuse as error:
        status = failed(misuse(error), 2).exit_code
    sys.exit(status)


def misuse(error: Any) -> str:
    """One sentence for a command line that cannot be read, and where its help stands."""
    command = error.ctx.command_path if error.ctx is not None else "phdtrack"
    sentence = " ".join(error.format_message().split())
    return f"{sentence if sentence.endswith(('.', '?')) else sentence + '.'} See {command} --help."
