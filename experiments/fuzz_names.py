"""Names of image sequences that cameras, tools and people might write:
``python -m experiments.fuzz_names --inputs N --seed S``.

Each input is a list of names in natural order: counters, clocks, and mixtures of both with gaps,
jumps, words and damaged characters. A finding is an exception, or numbers or times that do not
increase. Index and seed reproduce it.
"""

from __future__ import annotations

import argparse
import random
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from phdtrack.video.file_names import Numbering, numbering

_WORDS = ("img", "frame_", "cam1-", "IMG_", "日本", "\udce9", "%05d", "-", "._", " (", "x" * 200)
_CLOCKS = (
    "%Y%m%d%H%M%S",
    "%Y-%m-%d_%H-%M-%S",
    "%Y%m%d_%H%M%S_%f",
    "%Y.%m.%d %H.%M.%S",
    "%s",
    "%s.%f",
)
_DIGITS = re.compile(r"\d+")
_MOST = 40


def make_names(rng: random.Random) -> list[str]:
    """Names of 1 to 40 files, sorted as a folder is."""
    make = rng.choice([_counters, _clocks, _mixed, _noise])
    count = rng.randint(1, _MOST)
    names = make(rng, count)
    if rng.random() < 0.2:
        names[rng.randrange(count)] += rng.choice(_WORDS)
    if rng.random() < 0.2:
        names += _noise(rng, 1)
    return sorted(set(names), key=lambda name: _DIGITS.sub(lambda found: found[0].zfill(30), name))


def _counters(rng: random.Random, count: int) -> list[str]:
    width = rng.choice([0, 0, 4, 6, 10, 14, 19])
    step = rng.choice([1, 1, 1, 2, 10, 999, 1001, 40_000])
    number = rng.choice([0, 1, 7, 20241128, 10 ** rng.randint(0, 25)])
    word = rng.choice(_WORDS)
    end = rng.choice(["", "", "_left", "-1", "b"])
    names = list[str]()
    for _ in range(count):
        names.append(f"{word}{number:0{width}d}{end}")
        number += step * rng.choice([1, 1, 1, 1, 2, 1200, 10**9]) + rng.choice([0, 0, 0, 1])
    return names


def _clocks(rng: random.Random, count: int) -> list[str]:
    form = rng.choice(_CLOCKS)
    at = datetime(1965, 1, 1, tzinfo=UTC) + timedelta(seconds=rng.uniform(0, 4e9))
    step = rng.choice([0.04, 1.0, 60.0, 3e6])
    word = rng.choice(_WORDS)
    names = list[str]()
    for k in range(count):
        seconds = str(int(at.timestamp()))
        names.append(word + at.strftime(form.replace("%s", seconds)) + rng.choice(["", f"_{k}"]))
        at += timedelta(seconds=step * rng.choice([1, 1, 1, 0, 5]))
    return names


def _mixed(rng: random.Random, count: int) -> list[str]:
    half = max(1, count // 2)
    return (_counters(rng, half) + _clocks(rng, count))[:count]


def _noise(rng: random.Random, count: int) -> list[str]:
    letters = "0123456789009. _-TZabc:\n\udcff٣²"
    return ["".join(rng.choices(letters, k=rng.randint(1, 30))) for _ in range(count)]


def wrong(found: Numbering, count: int) -> str:
    """What is wrong with the numbering of so many names; empty if nothing is."""
    if len(found.numbers) != count or found.numbers[0] != 1:
        return "a number for each, from 1"
    if not all(a < b for a, b in pairwise(found.numbers)):
        return "numbers that increase"
    if found.times and not (found.times[0] == 0 and all(a < b for a, b in pairwise(found.times))):
        return "times that increase from 0"
    return ""


def main(words: list[str] | None = None, show: Callable[[str], None] = print) -> int:
    """Run it; the exit status is 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(words)
    findings = 0
    kinds = dict[str, int]()
    for index in range(options.inputs):
        names = make_names(random.Random(f"{options.seed}-{index}"))
        try:
            found = numbering(names)
            problem = wrong(found, len(names))
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        if problem:
            findings += 1
            show(f"{index}: {problem}: {names!r}")
            continue
        kind = re.sub(r"\d+\S*", "#", found.note) or "frame numbers"
        kinds[kind] = kinds.get(kind, 0) + 1
    for kind, number in sorted(kinds.items(), key=lambda pair: -pair[1]):
        show(f"{number} of {options.inputs}: {kind}")
    show(f"{findings} findings")
    return int(findings > 0)


if __name__ == "__main__":
    raise SystemExit(main())
