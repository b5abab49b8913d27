"""phdtrack's PHD filters against Stone Soup's: the same detections, the same model, the same
births.

The scene is the workload's with errors of √3 pixels in position and √6 in size, and the model
describes it in terms that both have: a linear-Gaussian motion and sensor of boxes (six components,
four of them measured) with these errors, p_D = 0.95, clutter and births uniform over the area and
the sizes that occur, births around the detections of the frame where little mass is predicted.
(With κ over all sizes of the image, as M09 has it, two false alarms in a row were a target to
both.)

Both GM-PHD filters prune at 1e-5 and merge at distance 2. `SETTINGS` are what Stone Soup offers to
be fast, k-d trees for the hypotheses and for the merging; the fastest at each size counts (without
trees, which is quadratic, only at the smallest one). Its SMC-PHD filter has 15 000 particles in
every frame, as ours has at least (1500 for each of ten targets), and a fifth as many newborn. Times
are those of a whole step (predict, update, reduce) without extraction. The states scored by OSPA
are, of mixtures, components of weight ≥ 0.5, and of particles, the clusters that phdtrack's K-means
finds. The difference of the OSPA distances, frame by frame, comes with its standard error over runs
of `BATCH` frames of all seeds (fewer seeds at more targets); no worse means no worse by more than
two of these.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from benchmarks.loops import Lap, Loop, Ours, race
from benchmarks.parts import Outcome, Row, Scale, Skipped
from benchmarks.timing import Spread
from benchmarks.workload import Crowd, draw, stages
from phdtrack.filters import GMPHD
from phdtrack.models import MeasurementBirth, UniformClutter
from phdtrack.models.volumes import image_volume
from phdtrack.protocols import AnyStages
from phdtrack.types import Estimates, GaussianMixture

KEYS = ("ratio_stonesoup_gm", "ratio_stonesoup_smc", "stonesoup")
SETTINGS = (
    {"gate": "none", "merge": "none"},
    {"gate": "tree", "merge": "none"},
    {"gate": "tree", "merge": "tree"},
)
LEAST_GM = 500.0
LEAST_SMC = 30.0
WARM_UP = 10
BATCH = 10
NOISE = (3.0**0.5, 6.0**0.5)
# Speeds are 0.7 pixels a frame across and 1.4 along on average, as amplitude of one law; nothing
# accelerates or grows, but targets turn at the borders.
MODEL = ("sensor.birth_speed_pixels=2.0", "motion.acceleration=0.3", "motion.size_noise=0.3")
Both = Callable[[int], tuple[Loop, Loop]]


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """GM-PHD at each size, SMC-PHD at the smallest."""
    if importlib.util.find_spec("stonesoup") is None:
        raise Skipped("stonesoup is not installed: pip install 'phdtrack[dev]'")
    from benchmarks.stone_soup_loops import Mixture, Sampled

    rows: list[Row] = []
    details = []
    gm: dict[str, float] = {}
    few = min(scale.stone_sizes)
    chosen: dict[str, dict[str, str]] = {}
    for targets in scale.stone_sizes:
        say(f"GM-PHD, {targets} targets")
        crowd = crowd_of(targets, scale.stone_frames)
        built = described(crowd)
        settings = chosen[str(targets)] = _fastest(
            crowd, SETTINGS if targets == few else SETTINGS[1:]
        )
        ours, theirs = _over_seeds(
            crowd,
            scale,
            lambda _, b=built, n=targets, s=settings: (OurMixture(b, 10 * n), Mixture(b, s, 4 * n)),
        )
        lines, detail = _compared("GM-PHD", targets, ours, theirs, LEAST_GM)
        gm[str(targets)] = detail["ratio"]
        rows += lines
        details.append(detail)
    say(f"SMC-PHD, {few} targets")
    crowd = crowd_of(few, scale.stone_frames)
    built = described(crowd)
    as_many = replace(built, filter=replace(built.filter, min_particles=scale.stone_particles))
    ours, theirs = _over_seeds(
        crowd,
        scale,
        lambda seed: (Ours(as_many, seed), Sampled(built, scale.stone_particles, seed)),
    )
    # Of ours the filter's step alone, as of theirs.
    step = replace(ours, seconds=ours.seconds[:, :1], cpu=ours.cpu[:, :1])
    lines, detail = _compared(
        f"SMC-PHD, {scale.stone_particles} particles", few, step, theirs, LEAST_SMC
    )
    entries = {
        "ratio_stonesoup_gm": min(gm.values()),
        "ratio_stonesoup_smc": detail["ratio"],
        "stonesoup": {
            "ratios_gm": gm,
            "runs": [*details, detail],
            "settings": chosen,
            "frames": scale.stone_frames,
            "seeds": list(scale.stone_seeds),
        },
    }
    return Outcome((*rows, *lines), entries)


def crowd_of(targets: int, frames: int) -> Crowd:
    """The scene."""
    return Crowd(targets, frames, noise=NOISE)


def described(crowd: Crowd) -> AnyStages:
    """The model of the scene, in phdtrack's particle filter with K-means.

    phdtrack's births know one volume, all boxes of the image: their rate is made larger to have the
    density that is meant.
    """
    built = stages(crowd, preset="fv", sets=MODEL)
    low, high = crowd.widths
    area = float(crowd.info.width * crowd.info.height)
    volume = area * (high - low) * crowd.aspect * (high - low)
    birth = built.model.birth
    assert isinstance(birth, MeasurementBirth)
    denser = replace(
        birth, births_per_second=birth.births_per_second * image_volume(birth.frame_size) / volume
    )
    clutter = UniformClutter(crowd.false_alarms, volume)
    return replace(built, model=replace(built.model, birth=denser, clutter=clutter))


class OurMixture:
    """phdtrack's GM-PHD filter without extraction, at most ``most`` components."""

    def __init__(self, built: AnyStages, most: int) -> None:
        self.loop = Ours(replace(built, filter=GMPHD(max_components=most), extractor=_Nothing()), 1)

    def frame(self, number: int, detections: Any) -> Any:
        """Seconds of a step, and the means of the components of weight ≥ 0.5."""
        seconds, _ = self.loop.frame(number, detections)
        state: GaussianMixture = self.loop.state
        return seconds[:1], state.mean[:2, state.weight >= 0.5]


class _Nothing:
    """Extracts nothing."""

    def extract(self, state: Any, z: Any, model: Any) -> Any:
        return Estimates.empty(model.motion.dim)


def _fastest(crowd: Crowd, tried: tuple[dict[str, str], ...]) -> dict[str, str]:
    """The setting that takes the least processor time, once the mixture has grown."""
    from benchmarks.stone_soup_loops import Mixture

    built = described(crowd)
    loops = [Mixture(built, settings, 4 * crowd.targets) for settings in tried]
    short = replace(crowd, frames=min(crowd.frames, WARM_UP))
    laps = race(loops, draw(short, 1), short.frames // 2)
    return tried[int(np.argmin([lap.cpu_median() for lap in laps]))]


def _over_seeds(crowd: Crowd, scale: Scale, both: Both) -> tuple[Lap, Lap]:
    """Ours and theirs on the scene of every seed, after the warm-up, one after the other."""
    seeds = scale.stone_seeds[
        : max(1, len(scale.stone_seeds) * min(scale.stone_sizes) // crowd.targets)
    ]
    laps = [
        race(both(seed), draw(crowd, seed), min(WARM_UP, crowd.frames // 2), math.inf)
        for seed in seeds
    ]
    ours, theirs = (_joined([pair[who] for pair in laps]) for who in (0, 1))
    return ours, theirs


def _joined(laps: list[Lap]) -> Lap:
    return Lap(
        *(np.concatenate([getattr(lap, field.name) for lap in laps]) for field in fields(Lap))
    )


def batch_error(values: np.ndarray[Any, Any], size: int = BATCH) -> float:
    """Standard error of the mean of a series whose neighbours depend on each other, from means of
    ``size`` in a row.
    """
    batches = max(len(values) // size, 1)
    means = [part.mean() for part in np.array_split(values, batches)]
    return float(np.std(means, ddof=1) / math.sqrt(batches)) if batches > 1 else float("nan")


def _compared(
    name: str, targets: int, ours: Lap, theirs: Lap, least: float
) -> tuple[list[Row], dict[str, Any]]:
    """Rows of the time, the ratio and the OSPA distances."""
    mine = Spread.of(ours.total, 1e3)
    other = Spread.of(theirs.total, 1e3)
    ratio = other.median / mine.median
    of_cpu = theirs.cpu_median() / ours.cpu_median()
    ospa = {"phdtrack": float(np.mean(ours.ospa)), "stonesoup": float(np.mean(theirs.ospa))}
    above = ospa["phdtrack"] - ospa["stonesoup"]
    error = batch_error(ours.ospa - theirs.ospa)
    note = (
        f"OSPA {ospa['stonesoup']:.2f} px, ours {ospa['phdtrack']:.2f} px in {mine.median:.3g} ms"
    )
    note += (
        f"; targets too many {np.mean(theirs.count):+.2f}, ours {np.mean(ours.count):+.2f};"
        f" {len(theirs.total)} frames"
    )
    most = 0.0 if math.isnan(error) else 2 * error
    rows = [
        Row(
            f"Stone Soup {name}, {targets} targets",
            other.median,
            "ms",
            other,
            cpu=theirs.cpu_median(1e3),
            note=note,
        ),
        Row(
            f"phdtrack against Stone Soup's {name}, {targets} targets",
            ratio,
            "×",
            cpu=of_cpu,
            least=least,
        ),
        Row(
            f"OSPA above Stone Soup's, {name}, {targets} targets",
            above,
            "px",
            most=most,
            note=f"± {error:.3f} (standard error); the limit is two of them",
        ),
    ]
    detail = {
        "filter": name,
        "targets": targets,
        "ratio": ratio,
        "ratio_cpu": of_cpu,
        "ospa": ospa,
        "ospa_above": above,
        "ospa_above_error": error,
        "frames": len(theirs.total),
    }
    return rows, {**detail, "phdtrack_ms": mine.as_dict(), "stonesoup_ms": other.as_dict()}
