"""phdtrack's PHD filters against Stone Soup's: the same detections, the same model, births of the same mass.

The model is one that both can do: M09's fixed variances, a linear-Gaussian motion and sensor of boxes (six components, four
of them measured), p_D = 0.95, births around the detections of the frame where little mass is predicted. The scene is the
workload's, with errors of about the sensor's size.

Both GM-PHD filters prune at 1e-5 and merge at distance 2. `SETTINGS` are what Stone Soup offers to be fast, k-d trees for
the hypotheses and for the merging; the fastest at the smallest size counts. Its SMC-PHD filter has 15 000 particles and a
fifth as many newborn. Times are those of a whole step (predict, update, reduce) without extraction. The states scored by
OSPA are, of mixtures, components of weight ≥ 0.5, and of particles, the clusters that phdtrack's K-means finds.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.loops import Lap, Ours, race
from benchmarks.parts import Outcome, Row, Scale, Skipped
from benchmarks.timing import Spread
from benchmarks.workload import Crowd, Stream, draw, stages
from phdtrack.filters import GMPHD
from phdtrack.protocols import AnyStages
from phdtrack.types import Estimates, GaussianMixture

KEYS = ("ratio_stonesoup_gm", "ratio_stonesoup_smc", "stonesoup")
SETTINGS = ({"gate": "none", "merge": "none"}, {"gate": "tree", "merge": "none"}, {"gate": "tree", "merge": "tree"})
LEAST_GM, LEAST_SMC = 500.0, 30.0
WARM_UP = 10


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """GM-PHD at each size, SMC-PHD at the smallest."""
    if importlib.util.find_spec("stonesoup") is None:
        raise Skipped("stonesoup is not installed: pip install 'phdtrack[dev]'")
    rows, details = [], []
    gm: dict[str, float] = {}
    settings = None
    for targets in scale.stone_sizes:
        say(f"GM-PHD, {targets} targets")
        stream = _scene(targets, scale.stone_frames)
        settings = settings or _fastest(targets, stream, min(WARM_UP, scale.stone_frames // 2))
        lines, detail = _gm(targets, stream, settings, min(WARM_UP, scale.stone_frames // 2))
        gm[str(targets)] = detail["ratio"]
        rows += lines
        details.append(detail)
    targets = min(scale.stone_sizes)
    say(f"SMC-PHD, {targets} targets")
    lines, detail = _smc(targets, scale)
    entries = {
        "ratio_stonesoup_gm": min(gm.values()),
        "ratio_stonesoup_smc": detail["ratio"],
        "stonesoup": {"ratios_gm": gm, "runs": [*details, detail], "settings": settings},
    }
    return Outcome((*rows, *lines), entries)


def _crowd(targets: int, frames: int) -> Crowd:
    # σ = √3 pixels on boxes about 35 wide and 70 high.
    return Crowd(targets, frames, jitter=0.035)


def _scene(targets: int, frames: int) -> Stream:
    return draw(_crowd(targets, frames), 1)


def _stages(targets: int, frames: int) -> AnyStages:
    """Fixed variances, the particle filter with K-means."""
    return stages(_crowd(targets, frames), preset="fv")


class OurMixture:
    """phdtrack's GM-PHD filter without extraction, at most ``most`` components."""

    def __init__(self, built: AnyStages, most: int) -> None:
        self.loop = Ours(replace(built, filter=GMPHD(most=most), extractor=_Nothing()), 1)

    def frame(self, number: int, detections: Any) -> Any:
        """Seconds of a step, and the means of the components of weight ≥ 0.5."""
        seconds, _ = self.loop.frame(number, detections)
        state: GaussianMixture = self.loop.state
        return seconds[:1], state.mean[:2, state.weight >= 0.5]


class _Nothing:
    """Extracts nothing."""

    def extract(self, state: Any, z: Any, model: Any) -> Any:
        return Estimates.empty(model.motion.dim)


def _fastest(targets: int, stream: Stream, warm_up: int) -> dict[str, str]:
    from benchmarks.stone_soup_loops import Mixture

    built = _stages(targets, stream.info.frames)
    loops = [Mixture(built, settings, 4 * targets) for settings in SETTINGS]
    laps = race(loops, stream, warm_up)
    return SETTINGS[int(np.argmin([np.median(lap.total) for lap in laps]))]


def _gm(targets: int, stream: Stream, settings: dict[str, str], warm_up: int) -> tuple[list[Row], dict[str, Any]]:
    """The two GM-PHD filters."""
    from benchmarks.stone_soup_loops import Mixture

    built = _stages(targets, stream.info.frames)
    ours, theirs = race([OurMixture(built, 10 * targets), Mixture(built, settings, 4 * targets)], stream, warm_up)
    return _compared("GM-PHD", targets, ours, theirs, LEAST_GM)


def _smc(targets: int, scale: Scale) -> tuple[list[Row], dict[str, Any]]:
    """The two particle filters; of ours the filter's step alone is timed, as of theirs."""
    from benchmarks.stone_soup_loops import Sampled

    built = _stages(targets, scale.stone_frames)
    stream = _scene(targets, scale.stone_frames)
    ours, theirs = race(
        [Ours(built, 1), Sampled(built, scale.stone_particles, 1)], stream, min(WARM_UP, scale.stone_frames // 2)
    )
    step = Lap(ours.seconds[:, :1], ours.count, ours.ospa)
    return _compared(f"SMC-PHD, {scale.stone_particles} particles", targets, step, theirs, LEAST_SMC)


def _compared(name: str, targets: int, ours: Lap, theirs: Lap, least: float) -> tuple[list[Row], dict[str, Any]]:
    """Rows of the time, the ratio and the OSPA distances."""
    mine, other = Spread.of(ours.total, 1e3), Spread.of(theirs.total, 1e3)
    ratio = other.median / mine.median
    ospa = {"phdtrack": float(np.mean(ours.ospa)), "stonesoup": float(np.mean(theirs.ospa))}
    note = f"OSPA {ospa['stonesoup']:.2f} px, ours {ospa['phdtrack']:.2f} px in {mine.median:.3g} ms"
    note += f"; {len(theirs.total)} frames"
    rows = [
        Row(f"Stone Soup {name}, {targets} targets", other.median, "ms", other, note=note),
        Row(f"phdtrack against Stone Soup's {name}, {targets} targets", ratio, "×", least=least),
        Row(f"OSPA above Stone Soup's, {name}, {targets} targets", ospa["phdtrack"] - ospa["stonesoup"], "px", most=0.0),
    ]
    detail = {"filter": name, "targets": targets, "ratio": ratio, "ospa": ospa, "frames": len(theirs.total)}
    return rows, {**detail, "phdtrack_ms": mine.as_dict(), "stonesoup_ms": other.as_dict()}
