"""The papers' tables and figures, measured again: ``python -m experiments m07 [--quick]``.

Each experiment writes a page: the paper's figure next to ours, where the data differ, and where a
claim does not hold.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments import made
from phdtrack.errors import InputError


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment: the question that it answers, in one line, and whether it needs the real
    sequences. Its name is its module's.
    """

    about: str
    data: bool = True


# Short ones first.
EXPERIMENTS = {
    "count": Experiment("accuracy of the count, with known parameters", data=False),
    "vo": Experiment(
        "the standard scenarios of simulated points, straight and turning, by OSPA", data=False
    ),
    "groups": Experiment("annotated groups of pedestrians, from true positions and from a filter"),
    "plane": Experiment("tracks on the ground plane, in metres, compared with those in the image"),
    "e13": Experiment("E13 Figs. 1 and 2: people and groups on E13's own sequence"),
    "d14": Experiment(
        "D14 Tables I-III: SMC PHD and MCMC filters on centroids, by particles and noise"
    ),
    "videos": Experiment("from a video to tracks, with the package's detectors"),
    "counting": Experiment("counts at lines and in zones of real video, against the truth"),
    "suggestions": Experiment("suggestions for labelling: how many of those ticked are false"),
    "blobs": Experiment("merged and split blobs, with and without the merged-measurement model"),
    "m07": Experiment(
        "M07 Table 1, word by word and as one must: PHD against no filter; and default settings"
    ),
    "m09": Experiment(
        "M09 Figs. 14-16: births and false alarms learned, by the paper's recursion alone and with"
        " a second pass"
    ),
    "scenes": Experiment(
        "learned scenes with the default filter: births and false alarms, part by part"
    ),
    "day_night": Experiment(
        "false alarms from other places by night: scenes learned once, twice, or again and again",
        data=False,
    ),
    "peers": Experiment(
        "comparison with widely used trackers; contributions of the parts of the default filter"
    ),
    "cameras": Experiment(
        "new cameras and detectors, compared with other trackers, cross-validated over groups; and"
        " synthetic cameras"
    ),
    "degraded": Experiment(
        "the real sequences without scores, at a third of the rate, and with half of the"
        " detections, compared with other trackers"
    ),
    "appearance": Experiment(
        "what appearance is worth: made and real embeddings, colours, people who come back, cost"
    ),
    "classes": Experiment(
        "overlaid cars and people, tracked with classes, separately, and without classes"
    ),
    "rates": Experiment(
        "the same settings from one image in five minutes to a hundred a second, with lost frames"
    ),
    "regimes": Experiment(
        "the operating envelope: simple scenes from one to sixty frames a second, fast objects,"
        " rare detections, and regimes drawn at random"
    ),
}

# The command beside the experiments.
DATA = "data"
ABOUT_DATA = (
    "what real sequences are missing, where they are published, and --from DOWNLOADS, which brings"
    " them into their places"
)


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    out = argparse.ArgumentParser(
        prog="python -m experiments", description=__doc__, epilog=f"{DATA}: {ABOUT_DATA}"
    )
    out.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="experiments to run; all: every one, the short ones first",
    )
    out.add_argument(
        "--list", action="store_true", help="list the experiments with their questions"
    )
    out.add_argument(
        "--quick",
        action="store_true",
        help="a short form, whose figures are not results; those of the papers (m07, m09, e13, d14)"
        " take at most 90 seconds of processor time",
    )
    out.add_argument(
        "--runs",
        type=int,
        default=0,
        metavar="N",
        help="Monte Carlo runs of each case; default: its own",
    )
    out.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the pages; default: docs/results/, in short forms runs/",
    )
    out.add_argument(
        "--jobs", type=int, default=0, metavar="N", help="processes; default: one for each core"
    )
    out.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="seed of cases that are drawn at random (regimes), or the first of them (cameras);"
        " default: its own",
    )
    out.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="PART",
        help="make this part of the page anew and keep the others (appearance, m07); may be"
        " repeated",
    )
    out.add_argument(
        "--check",
        action="store_true",
        help="list pages that are older than their code and settings",
    )
    out.add_argument(
        "--confirm",
        action="store_true",
        help="run the short forms of old pages, of all or of these NAMEs, with the code that made"
        " them and with that of today: those with the same figures count as new",
    )
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the requested experiments; return the exit status, 2 for invalid input."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == [DATA]:
        from experiments import data

        return data.main(words[1:])
    command = parser()
    parsed = command.parse_args(words)
    if parsed.runs < 0 or parsed.jobs < 0:
        command.error("--runs and --jobs are numbers from 1 on; 0 stands for the default")
    if parsed.seed is not None and parsed.seed < 0:
        command.error("--seed is a number from 0 on")
    if parsed.list or not (parsed.names or parsed.check or parsed.confirm):
        print(
            "\n".join(
                f"{name:<10} {one.about}{'' if one.data else ' (no real data)'}"
                for name, one in EXPERIMENTS.items()
            )
        )
        print(f"{DATA:<10} {ABOUT_DATA}")
        return 0
    if parsed.check:
        return made.check(parsed.out or made.ROOT / "docs" / "results")
    try:
        if parsed.confirm:
            from experiments.confirm import confirm

            return confirm(parsed.out or made.ROOT / "docs" / "results", parsed.names)
        run([*EXPERIMENTS] if parsed.names == ["all"] else parsed.names, parsed)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def run(names: Sequence[str], parsed: argparse.Namespace) -> None:
    """Run the experiments with these names. Missing data is an error before the first one runs."""
    for name in names:
        if name not in EXPERIMENTS:
            near = difflib.get_close_matches(name, EXPERIMENTS, n=1)
            cure = (
                f"Did you mean {near[0]}?"
                if near
                else "python -m experiments --list says what there is"
            )
            raise InputError(
                f"expected one of {', '.join(EXPERIMENTS)}, got {name!r}",
                where="experiment",
                cure=cure,
            )
    for name in names:
        print(f"{name}: {EXPERIMENTS[name].about}", file=sys.stderr, flush=True)
    if parsed.quick:
        print("the short form: its figures are no results", file=sys.stderr, flush=True)
    # Loading the package takes seconds, so print the plan first.
    from experiments.common import Options, need_data

    if any(EXPERIMENTS[name].data for name in names):
        need_data()
    made.at_start()
    if len(names) > 1:
        # In separate processes, so that modules loaded by one are not recorded for another.
        _one_by_one(names)
        return
    for name in names:
        began = time.perf_counter()
        importlib.import_module(f"experiments.{name}").main(
            Options(
                parsed.runs,
                parsed.quick,
                parsed.out,
                parsed.jobs,
                name,
                parsed.seed,
                tuple(parsed.only),
            )
        )
        print(f"{name}: done in {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)


def _one_by_one(names: Sequence[str]) -> None:
    """Run each experiment as a command of its own, with the options of this one."""
    options = [word for word in sys.argv[1:] if word not in (*names, "all")]
    for name in names:
        done = subprocess.run([sys.executable, "-m", "experiments", name, *options], check=False)
        if done.returncode:
            raise InputError(f"status {done.returncode}, see above", where=f"the experiment {name}")


if __name__ == "__main__":
    sys.exit(main())
