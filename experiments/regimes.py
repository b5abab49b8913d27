"""The operating envelope: simple scenes over a grid of regimes, and regimes drawn at random.

The scenes, their scores and the grid come from `bench/regimes.py` next to the real sequences, the
peers' scores on the grid from `regimes_peers.csv` beside it. Peers on the random regimes of the
usual seed are in `experiments/regimes_peers.csv`; for another seed they run in the environment of
the peers (`make peers`). A regime's score is the mean over its scenes, in the frames in which the
detector ran.
"""

from __future__ import annotations

import csv
import tempfile
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from experiments import regimes_scenes
from experiments.common import (
    Options,
    in_parallel,
    need_data,
    run_peers,
    table,
    without_warnings,
    write,
)
from experiments.regimes_scenes import (
    CSV,
    PEERS,
    QUANTITIES,
    REGIMES,
    SCENES,
    SCORES,
    SEED,
    Parameters,
    described,
    random_regimes,
)
from phdtrack.errors import InputError

DEFAULT = ""
OTHERS = ("gm-phd", "gm-cphd", "particle-phd", "mht", "pmbm", "mcmc", "none")
# Differences that count on the grid, and on the few scenes of a random regime.
MARGIN = 0.02
RANDOM_MARGIN = 0.03
# Below this MOTA of every peer a regime cannot be tracked by any of them.
HOPELESS = 0.3
WORST = 10
WORST_OF_OTHERS = 3
# The short form: every so many scenes of the grid, fewer regimes, fewer scenes of other filters.
QUICK_STEP = 8
QUICK_REGIMES = 8
QUICK_OTHERS = 2


Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Regime:
    """A regime, and the best MOTA and IDF1 of the peers in it."""

    name: str
    parameters: Parameters
    best: Pair


@dataclass(frozen=True, slots=True)
class SceneRun:
    """A filter on one scene of a regime."""

    parameters: Parameters
    seed: int
    filter_name: str = DEFAULT


@dataclass(frozen=True, slots=True)
class RegimeScores:
    """MOTA and IDF1 of the online rows, of the corrected tracks, and of the best peer in each."""

    name: str
    online: Pair
    corrected: Pair
    best: Pair

    @property
    def gap(self) -> float:
        """How far the online rows are behind the best peer, in the worse of the two scores."""
        return max(self.best[0] - self.online[0], self.best[1] - self.online[1])

    @property
    def corrected_gap(self) -> float:
        """The same of the corrected tracks."""
        return max(self.best[0] - self.corrected[0], self.best[1] - self.corrected[1])

    @property
    def lead(self) -> float:
        """How far the online rows are ahead of the best peer in MOTA."""
        return self.online[0] - self.best[0]

    def verdict(self, margin: float) -> str:
        """``behind``, ``ahead``, or nothing."""
        if self.gap > margin:
            return "behind"
        return "ahead" if self.lead >= margin else ""


def bench() -> Path:
    """The folder of regimes.py and regimes_peers.csv; `InputError` if one is missing."""
    folder = need_data().parent / "bench"
    for name in ("regimes.py", "regimes_peers.csv"):
        if not (folder / name).is_file():
            raise InputError(
                "the scenes of the regimes or the peers' scores in them are missing",
                where=folder / name,
                cure="Put bench/ with regimes.py and regimes_peers.csv there",
            )
    return folder


def harness() -> ModuleType:
    """The module regimes.py of the folder of the comparison."""
    return regimes_scenes.harness(bench())


def scored(job: SceneRun) -> tuple[float, float, float, float]:
    """MOTA and IDF1 of the online rows, then of the corrected tracks."""
    module = harness()
    found, truth = module.scene(seed=job.seed, **job.parameters)
    ran = [k for k, detections in enumerate(found) if detections is not None]
    values: list[float] = []
    with without_warnings():
        runs = module.phdtrack(found, job.parameters, job.filter_name)
    for rows in runs:
        values += module.scores([truth[k] for k in ran], [rows.get(k, []) for k in ran])
    a, b, c, d = (float(value) for value in values)
    return a, b, c, d


def best_peers(path: Path) -> list[tuple[str, Pair]]:
    """The regimes of a file, each with the best MOTA and the best IDF1 of the peers."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            (
                row["regime"],
                (
                    max(float(row[f"{name}_mota"]) for name in PEERS),
                    max(float(row[f"{name}_idf1"]) for name in PEERS),
                ),
            )
            for row in csv.DictReader(file)
        ]


def regimes_of_grid() -> list[Regime]:
    """The regimes of the grid. Raises `InputError` if the file lacks one."""
    path = bench() / "regimes_peers.csv"
    best = dict(best_peers(path))
    grid: Mapping[str, Parameters] = harness().grid()
    missing = [name for name in grid if name not in best]
    if missing:
        raise InputError(
            f"no scores of the peers in the regime {missing[0]!r}",
            where=path,
            cure="Put regimes.py and regimes_peers.csv of one version there",
        )
    return [Regime(name, parameters, best[name]) for name, parameters in grid.items()]


def regimes_at_random(seed: int, number: int, jobs: int) -> list[Regime]:
    """Regimes drawn with ``seed``; the peers' scores are read from the file, or measured now.

    Raises `InputError` if the file is for other regimes, or if the peers' environment is missing.
    """
    drawn = random_regimes(seed, number)
    names = [described(one) for one in drawn]
    found = best_peers(CSV)[:number] if seed == SEED else measured_peers(seed, number, jobs)
    if [name for name, _ in found] != names:
        raise InputError(
            "the peers' scores are for other regimes than are drawn now",
            where=CSV,
            cure="Say make peers, then .venv-peers/bin/python -m experiments.regimes_peers"
            f" {bench()}",
        )
    return [
        Regime(name, parameters, best)
        for (name, best), parameters in zip(found, drawn, strict=True)
    ]


def measured_peers(seed: int, number: int, jobs: int) -> list[tuple[str, Pair]]:
    """The peers' scores in regimes drawn with ``seed``, measured in their own environment."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "peers.csv"
        words = [bench(), "--out", out, "--seed", seed, "--regimes", number]
        run_peers("regimes", words, jobs)
        return best_peers(out)


def compared(
    regimes: Sequence[Regime], seeds: int, options: Options, filter_name: str = DEFAULT
) -> list[RegimeScores]:
    """A filter in each regime, mean over ``seeds`` scenes, beside the best peer."""
    jobs = [
        SceneRun(regime.parameters, seed, filter_name)
        for regime in regimes
        for seed in range(seeds)
    ]
    found = in_parallel(scored, jobs, filter_name or "default filter", options)
    means = np.array(found).reshape(len(regimes), seeds, 4).mean(axis=1).tolist()
    return [
        RegimeScores(regime.name, (row[0], row[1]), (row[2], row[3]), regime.best)
        for regime, row in zip(regimes, means, strict=True)
    ]


def pair(values: Pair) -> str:
    """A cell with two scores."""
    return f"{values[0]:.3f} / {values[1]:.3f}"


def behind(found: Iterable[RegimeScores], margin: float) -> int:
    """In how many regimes the online rows are behind by more than ``margin``."""
    return sum(one.gap > margin for one in found)


def ahead(found: Iterable[RegimeScores], margin: float) -> int:
    """In how many regimes the online rows are ahead in MOTA by ``margin`` or more."""
    return sum(one.lead >= margin for one in found)


def worst(found: Iterable[RegimeScores], number: int) -> list[RegimeScores]:
    """The regimes in which the online rows are furthest behind."""
    return sorted(found, key=lambda one: -one.gap)[:number]


def scores_table(found: Iterable[RegimeScores], margin: float) -> str:
    """The scores of each regime beside the best peer's."""
    return table(
        ("regime", "online", "corrected", "best peer", ""),
        (
            (one.name, pair(one.online), pair(one.corrected), pair(one.best), one.verdict(margin))
            for one in found
        ),
    )


def quantities_table(found: Sequence[RegimeScores], regimes: Sequence[Regime]) -> str:
    """In how many of the regimes with a kind of scores, and of those in which a quantity is drawn,
    the default is behind and ahead.
    """
    groups: dict[str, list[RegimeScores]] = {}
    for one, regime in zip(found, regimes, strict=True):
        changed = [name for name in QUANTITIES if name in regime.parameters]
        for name in (f"scores {regime.parameters['score']}", *changed):
            groups.setdefault(name, []).append(one)
    order = [*(f"scores {kind}" for kind in SCORES), *QUANTITIES]
    rows = [
        (name, len(those), behind(those, RANDOM_MARGIN), ahead(those, RANDOM_MARGIN))
        for name in order
        if (those := groups.get(name))
    ]
    return table(("drawn", "regimes", "behind", "ahead"), rows)


def others_table(found: Mapping[str, Sequence[RegimeScores]]) -> str:
    """In how many regimes each filter is behind, and the worst ones."""
    rows = [
        (
            name,
            behind(scores, MARGIN),
            "; ".join(
                f"{one.name} ({one.online[0]:.2f} / {one.online[1]:.2f}, best peer"
                f" {one.best[0]:.2f} / {one.best[1]:.2f})"
                for one in worst(scores, WORST_OF_OTHERS)
            ),
        )
        for name, scores in found.items()
    ]
    return table(("filter", "behind", "worst"), rows)


def summary(grid: Sequence[RegimeScores], drawn: Sequence[RegimeScores]) -> str:
    """The lines of the README, wrapped."""
    text = (
        f"In {len(grid)} simple simulated scenes, each with one thing changed (1 to 60 frames a"
        " second, speed, kind of scores, how often the detector runs, p_D, clutter, noise, size),"
        f" online MOTA or IDF1 is more than {MARGIN:.2f} behind the best of SORT, ByteTrack and"
        f" OC-SORT in {behind(grid, MARGIN)}, and MOTA is {MARGIN:.2f} or more ahead in"
        f" {ahead(grid, MARGIN)}. In {len(drawn)} regimes drawn at random, with three or four"
        f" things changed at once, it is more than {RANDOM_MARGIN:.2f} behind in"
        f" {behind(drawn, RANDOM_MARGIN)} and as far ahead in {ahead(drawn, RANDOM_MARGIN)}."
    )
    return textwrap.fill(text, 100)


def main(options: Options) -> Path:
    """Compare everything, write regimes.md, and print the lines of the README."""
    seed = SEED if options.seed is None else options.seed
    seeds = options.number(5, 1)
    grid = regimes_of_grid()
    if options.quick:
        grid = grid[::QUICK_STEP]
    drawn = regimes_at_random(seed, QUICK_REGIMES if options.quick else REGIMES, options.jobs)
    on_grid = compared(grid, seeds, options)
    in_drawn = compared(drawn, SCENES, options)
    shared = grid[:QUICK_OTHERS] if options.quick else grid
    others = {name: compared(shared, 1, options, name) for name in OTHERS}
    print(summary(on_grid, in_drawn))
    return write(
        "regimes",
        options,
        seeds=seeds,
        margin=f"{MARGIN:.2f}",
        random_margin=f"{RANDOM_MARGIN:.2f}",
        scenes=SCENES,
        seed=seed,
        regimes=len(grid),
        shared=len(shared),
        drawn=len(drawn),
        behind=behind(on_grid, MARGIN),
        ahead=ahead(on_grid, MARGIN),
        corrected_behind=sum(one.corrected_gap > MARGIN for one in on_grid),
        grid=scores_table(on_grid, MARGIN),
        drawn_behind=behind(in_drawn, RANDOM_MARGIN),
        drawn_ahead=ahead(in_drawn, RANDOM_MARGIN),
        drawn_corrected=sum(one.corrected_gap > RANDOM_MARGIN for one in in_drawn),
        hopeless=sum(one.best[0] < HOPELESS for one in in_drawn),
        hopeless_mota=HOPELESS,
        worst_number=min(WORST, len(in_drawn)),
        worst=scores_table(worst(in_drawn, WORST), RANDOM_MARGIN),
        quantities=quantities_table(in_drawn, drawn),
        others=others_table(others),
    )
