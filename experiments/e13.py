"""E13 on its own sequence: counting people on the ground plane with a detector that misses three of
ten.

PETS 2009 S1L1, time 13-57, view 1: the truth is public, E13's detections are not, so they are
simulated from the truth. The drop model was fixed before any filter was run, and no parameter was
tuned on the outcome:

* a person with the share c covered by a nearer box is detected with probability 0.95 (1 − 0.75 c),
  which is 0.69 on average (E13 states 0.7);
* boxes are jittered by 10 % of the width across, 5 % of the height down (their foot) and 5 % in
  size;
* clutter is Poisson, 0.1 or 1 box a frame, boxes of the truth's sizes standing anywhere on the
  ground that people walk on.

All other parameters are E13's. With ``occlusion``, p_D is 0.95 for a visible person, as in the
detector, and falls with the share covered by other targets. ``rates`` replaces E13's birth places
(0.011 people a frame; 0.2 a frame arrive) and its clutter density (about 10⁻⁵ a frame) by the true
rates of the scene with births anywhere, and R by each detection's own covariance: the cardinalised
filter depends on correct rates. People are counted as E13's head count, Σ w over all components; as
Σ round(w), which counts a component that has merged several people as often as it weighs; and by
the extracted states, each component once. Groups are those of E13's rule (2 m, 1 m/s), for several
weights from which a component counts, because no paper states one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments import e13_detectors
from experiments.claims import MENDED, OURS, WORDS, Claim, decided
from experiments.common import Options, in_parallel, need_data, pyplot, table, with_error, write
from experiments.verdicts import rule, with_seeds
from phdtrack import config, pipeline
from phdtrack.arrays import area, intersection
from phdtrack.filters.cardinality import Cardinalised
from phdtrack.formats import read_truth
from phdtrack.ground import read_camera
from phdtrack.groups.clusters import Grouping, Groups
from phdtrack.groups.contours import Contours
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import counted
from phdtrack.types import F8, Detections, GaussianMixture, SequenceInfo, Step, Truth

INFO = SequenceInfo(768, 576, 7.0, 221, "PETS2009-S1L1-1")
SEEDS = 3
CLUTTER = (0.1, 1.0)
PICTURED = (10, 40, 80, 120)
# Weights from which a component counts for groups; the second is the default.
WEIGHTS = (0.1, 0.25, 0.5)
USUAL_WEIGHT = WEIGHTS.index(Grouping().min_weight)
FREE = 0.95
FALL = 0.75
# The changes of each filter to the preset e13.
AWARE = ("sensor.occlusion=true", f"sensor.detection_probability={FREE}")
# The ground that the people of the sequence walk on, metres.
REGION = "camera.region=[-16.0, -18.0, -3.0, 10.0]"
ARRIVALS = 0.2
RATES = (
    "sensor.scaling=given",
    "birth.kind=ground",
    f"birth.births_per_second={7 * ARRIVALS}",
    REGION,
    "clutter.clutter_per_frame=0.3",
    "clutter.density=0.0",
)
FILTERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "GM-PHD": ("gm-phd", ()),
    "GM-PHD, occlusion": ("gm-phd", AWARE),
    "GM-CPHD": ("gm-cphd", ()),
    "GM-CPHD, occlusion": ("gm-cphd", AWARE),
    "GM-PHD, rates": ("gm-phd", RATES),
    "GM-PHD, rates, occlusion": ("gm-phd", RATES + AWARE),
    "GM-CPHD, rates": ("gm-cphd", RATES),
    "GM-CPHD, rates, occlusion": ("gm-cphd", RATES + AWARE),
    "GM-PHD, rates, true hiders": ("gm-phd", RATES + AWARE),
    "GM-CPHD, rates, true hiders": ("gm-cphd", RATES + AWARE),
}


# E13's filter; with the rates of the scene, which its births and clutter are far from; and the
# cardinalised one with these.
FORMS = {WORDS: "GM-PHD", MENDED: "GM-PHD, rates", OURS: "GM-CPHD, rates"}


@dataclass(frozen=True, slots=True)
class CrowdRun:
    """One run: a filter by its name in `FILTERS`, the clutter's rate and the seed of the
    detections.
    """

    filter: str
    clutter: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class CrowdCounts:
    """By frame: ``mass`` Σ w, ``rounded`` Σ round(w), number of ``states`` and of ``raw``
    detections, and ``groups`` (W, F), the number of groups of the intensity for each of `WEIGHTS`.
    """

    mass: F8
    rounded: F8
    states: F8
    raw: F8
    groups: F8


@lru_cache(maxsize=1)
def truth() -> Truth:
    """The annotated people."""
    return read_truth(need_data() / "pets2009" / f"{INFO.name}.xml")


def camera_file() -> Path:
    """The camera of view 1."""
    return need_data() / "pets2009" / "View_001.xml"


def feet(xyxy: F8) -> F8:
    """(2, n) middles of the lower edges."""
    return np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]])


def covered(xyxy: F8) -> F8:
    """(n,) the largest share of each box covered by one nearer box of the frame; a nearer box has a
    lower bottom edge.
    """
    shared = intersection(xyxy, xyxy) * (xyxy[:, 3] > xyxy[:, None, 3])
    part: F8 = (shared / area(xyxy)[:, None]).max(axis=1, initial=0.0)
    return part


def detected(number: int, clutter: float, rng: np.random.Generator) -> Detections:
    """The detections of frame ``number``."""
    boxes = truth().xyxy[truth().frame == number]
    seen = boxes[rng.random(len(boxes)) < FREE * (1 - FALL * covered(boxes))]
    false = truth().xyxy[rng.integers(len(truth()), size=rng.poisson(clutter))]
    # A false alarm has the size of an annotated box and stands near one.
    everything = np.vstack([_jittered(seen, 1.0, rng), _jittered(false, 5.0, rng)])
    return Detections.of(everything[rng.permutation(len(everything))])


def _jittered(xyxy: F8, more: float, rng: np.random.Generator) -> F8:
    size = xyxy[:, 2:] - xyxy[:, :2]
    foot = feet(xyxy).T + more * np.array([0.1, 0.05]) * size * rng.standard_normal((len(xyxy), 2))
    size = size * np.exp(0.05 * rng.standard_normal((len(xyxy), 2)))
    return np.column_stack(
        [
            foot[:, 0] - size[:, 0] / 2,
            foot[:, 1] - size[:, 1],
            foot[:, 0] + size[:, 0] / 2,
            foot[:, 1],
        ]
    )


def stages_of(name: str, clutter: float) -> AnyStages:
    """The stages of a filter by its name in `FILTERS`."""
    kind, sets = FILTERS[name]
    rate = (f"clutter.clutter_per_frame={clutter}",) if RATES[0] in sets else ()
    return config.build(
        config.load(None, (f"camera.file={camera_file()}", *sets, *rate), "e13"), INFO, kind
    )


def mixture_of(intensity: GaussianMixture | Cardinalised[GaussianMixture]) -> GaussianMixture:
    """The Gaussians that a filter carries."""
    return intensity.intensity if isinstance(intensity, Cardinalised) else intensity


def run(job: CrowdRun) -> Iterator[tuple[GaussianMixture, Step]]:
    """The intensity and the step of each frame."""
    stages = stages_of(job.filter, job.clutter)
    camera = read_camera(camera_file())
    drops = np.random.default_rng([job.seed, int(10 * job.clutter)])
    rng = np.random.default_rng(job.seed)
    state = pipeline.start(stages, rng)
    for number in range(1, INFO.frames + 1):
        found = detected(number, job.clutter, drops)
        if "true hiders" in job.filter:
            place = camera.ground(feet(truth().xyxy[truth().frame == number]))
            state = replace(state, targets=np.vstack([place, np.zeros_like(place)]))
        state, step = pipeline.advance(stages, state, found, number, (number - 1) / INFO.fps, rng)
        yield mixture_of(state.intensity), step


def work(job: CrowdRun) -> CrowdCounts:
    """One run over the sequence."""
    rows = [
        (
            step.info.mass,
            np.rint(mixture.weight).sum(),
            len(step.estimates),
            len(step.detections),
            *(len(Grouping(min_weight=weight).groups(mixture).count) for weight in WEIGHTS),
        )
        for mixture, step in run(job)
    ]
    columns = np.array(rows, dtype=np.float64).T
    mass, rounded, states, raw = columns[:4]
    return CrowdCounts(mass, rounded, states, raw, columns[4:])


def true_groups() -> tuple[F8, dict[int, Groups], dict[int, GaussianMixture]]:
    """Number of groups that E13's rule finds in the true positions by frame; groups and people of
    the pictured frames.

    Velocities are slopes of lines fitted to a person's positions within half a second.
    """
    camera = read_camera(camera_file())
    annotated = truth()
    place = camera.ground(feet(annotated.xyxy))
    counts = np.zeros(INFO.frames)
    groups = dict[int, Groups]()
    people = dict[int, GaussianMixture]()
    for number in range(1, INFO.frames + 1):
        now = np.flatnonzero(annotated.frame == number)
        state = np.vstack(
            [place[:, now], np.column_stack([_velocity(annotated, place, int(i)) for i in now])]
        )
        mixture = GaussianMixture(
            np.ones(len(now)), state, np.tile(0.09 * np.eye(4), (len(now), 1, 1))
        )
        found = Grouping().groups(mixture)
        counts[number - 1] = len(found.count)
        if number in PICTURED:
            groups[number] = found
            people[number] = mixture
    return counts, groups, people


def _velocity(annotated: Truth, place: F8, i: int) -> F8:
    """(2,) metres per second of the person of row ``i``."""
    near = (annotated.identity == annotated.identity[i]) & (
        np.abs(annotated.frame - annotated.frame[i]) <= 3
    )
    time = (annotated.frame[near] - annotated.frame[i]) / INFO.fps
    if len(time) < 2:
        return np.zeros(2)
    out: F8 = np.polyfit(time, place[:, near].T, 1)[0]
    return out


def main(options: Options) -> Path:
    """Run everything and write the page with its pictures."""
    seeds = options.number(SEEDS, 1)
    rates = CLUTTER[:1] if options.quick else CLUTTER
    jobs = [
        CrowdRun(name, clutter, seed)
        for clutter in rates
        for name in FILTERS
        for seed in range(seeds)
    ]
    results = dict(zip(jobs, in_parallel(work, jobs, "e13", options), strict=True))
    people = np.bincount(truth().frame, minlength=INFO.frames + 1)[1:].astype(np.float64)
    groups, pictured_groups, pictured = true_groups()
    rows = [row for clutter in rates for row in _rows(results, clutter, people, groups, seeds)]
    pictures(results, people, groups, pictured_groups, pictured, options.folder)
    found = CrowdResults(results, people, groups, rates, seeds)
    return write(
        "e13",
        options,
        claims_of(found),
        seeds=counted(seeds, "seed"),
        table=table(HEADER, rows),
        weights=weights_table(found),
        recall=f"{recall():.2f}",
        people=f"{people.mean():.1f}",
        steps=f"{np.abs(np.diff(people)).mean():.1f}",
        hidden=hidden_sentence(found),
        rule=rule(),
        detectors=e13_detectors.section(options),
    )


HEADER = (
    "clutter",
    "filter",
    "Σ w: error",
    "bias",
    "of the raw error",
    "jumps",
    "Σ round(w): error",
    "bias",
    "components: error",
    "groups: error",
)


@dataclass(frozen=True, slots=True, eq=False)
class CrowdResults:
    """All runs; the true numbers of ``people`` and of ``groups`` by frame; the ``rates`` of clutter
    and the number of ``seeds``.
    """

    results: Mapping[CrowdRun, CrowdCounts]
    people: F8
    groups: F8
    rates: Sequence[float]
    seeds: int

    def runs(self, name: str, clutter: float) -> list[CrowdCounts]:
        """The runs of a filter, one for each seed."""
        return [self.results[CrowdRun(name, clutter, seed)] for seed in range(self.seeds)]

    def errors(self, name: str, clutter: float, of: str) -> F8:
        """(seeds,) mean absolute errors of a count of people."""
        each = [np.abs(getattr(one, of) - self.people).mean() for one in self.runs(name, clutter)]
        return np.array(each)

    def biases(self, name: str, clutter: float, of: str) -> F8:
        """(seeds,) mean errors of a count of people."""
        each = [(getattr(one, of) - self.people).mean() for one in self.runs(name, clutter)]
        return np.array(each)

    def jumps(self, name: str, clutter: float) -> F8:
        """(seeds,) mean absolute changes of Σ w from frame to frame."""
        return np.array([np.abs(np.diff(one.mass)).mean() for one in self.runs(name, clutter)])

    def off_groups(self, name: str, clutter: float) -> F8:
        """(seeds, W, F) absolute errors of the number of groups, for each weight."""
        return np.array([np.abs(one.groups - self.groups) for one in self.runs(name, clutter)])


def weights_table(found: CrowdResults) -> str:
    """Errors of the number of groups, and the share of frames with the right one, by the weight
    from which a component counts.
    """
    rows = []
    for clutter in found.rates:
        for form, name in FORMS.items():
            off = found.off_groups(name, clutter)
            cells = (
                f"{error:.2f} ({100 * right:.0f} %)"
                for error, right in zip(
                    off.mean(axis=(0, 2)), (off == 0).mean(axis=(0, 2)), strict=True
                )
            )
            rows.append((f"{clutter:g}", name, form, *cells))
    return table(("clutter", "filter", "", *(f"from {one:g}" for one in WEIGHTS)), rows)


def claims_of(found: CrowdResults) -> list[Claim]:
    """E13's claims, and what its conclusion expects of the cardinalised filter and of p_D(x)."""
    return [
        *(
            _nearer(found, form, of, sign)
            for of, sign in (("mass", "Σ w"), ("rounded", "Σ round(w)"))
            for form in FORMS
        ),
        *(_grouped(found, form) for form in FORMS),
        *(_jumps(found, form) for form in (WORDS, MENDED)),
        _mended(found),
        *(_lowered(found, form) for form in (WORDS, MENDED)),
    ]


def _judged(
    found: CrowdResults,
    claim: str,
    form: str,
    figures: str,
    gaps: Mapping[str, F8],
    printed: str = "expected",
) -> Claim:
    """A claim about differences over the seeds, positive if as claimed, by case."""
    return Claim(
        claim,
        printed,
        form,
        with_seeds(figures, found.seeds),
        {name: decided(each.tolist()) for name, each in gaps.items()},
    )


def _nearer(found: CrowdResults, form: str, of: str, sign: str) -> Claim:
    """A count of people is nearer to the truth than the number of detections."""
    name = FORMS[form]
    ours, raw = (found.errors(name, found.rates[0], one).mean() for one in (of, "raw"))
    return _judged(
        found,
        f"the number of people, {sign}, is nearer to the truth than the raw number",
        form,
        f"error {ours:.2f}, raw {raw:.2f}",
        {
            _clutter(rate): found.errors(name, rate, "raw") - found.errors(name, rate, of)
            for rate in found.rates
        },
        "Fig. 1, a curve",
    )


def _grouped(found: CrowdResults, form: str) -> Claim:
    """The number of groups is right in more than half of the frames, for each weight."""
    off = found.off_groups(FORMS[form], found.rates[0])
    right = (off == 0).mean(axis=2)
    return _judged(
        found,
        "the correct number of groups, in most frames",
        form,
        f"error {off[:, USUAL_WEIGHT].mean():.2f}, right in"
        f" {100 * right[:, USUAL_WEIGHT].mean():.0f} % of the frames",
        {f"from weight {weight:g}": right[:, k] - 0.5 for k, weight in enumerate(WEIGHTS)},
        "Fig. 2, four frames",
    )


def _jumps(found: CrowdResults, form: str) -> Claim:
    """Σ w changes more than twice as much from frame to frame as the truth."""
    true = float(np.abs(np.diff(found.people)).mean())
    jumps = {rate: found.jumps(FORMS[form], rate) for rate in found.rates}
    return _judged(
        found,
        "the number of people jumps",
        form,
        f"{jumps[found.rates[0]].mean():.2f} a frame, truth {true:.2f}",
        {_clutter(rate): each - 2 * true for rate, each in jumps.items()},
        "stated",
    )


def _mended(found: CrowdResults) -> Claim:
    """The cardinalised filter jumps less than half as much."""
    jumps = [
        {rate: found.jumps(FORMS[form], rate) for rate in found.rates} for form in (OURS, MENDED)
    ]
    claim = "a cardinalised filter mends the jumps"
    return _below(found, claim, OURS, ("{:.2f} a frame, without {:.2f}", 0.5), *jumps)


def _lowered(found: CrowdResults, form: str) -> Claim:
    """The error of Σ w is lower with p_D(x) than with a constant p_D."""
    name = FORMS[form]
    errors = [
        {rate: found.errors(each, rate, "mass") for rate in found.rates}
        for each in (f"{name}, occlusion", name)
    ]
    claim = "p_D(x) that falls behind others lowers the error of the number of people"
    return _below(found, claim, form, ("error {:.2f} with, {:.2f} without", 1.0), *errors)


def _below(
    found: CrowdResults,
    claim: str,
    form: str,
    said: tuple[str, float],
    ours: Mapping[float, F8],
    plain: Mapping[float, F8],
) -> Claim:
    """Figures (seeds,) by clutter, ``ours`` below a share of the ``plain`` ones; ``said`` has the
    words for both means at the lowest clutter, and the share.
    """
    words, share = said
    first = found.rates[0]
    gaps = {_clutter(rate): share * plain[rate] - ours[rate] for rate in found.rates}
    return _judged(found, claim, form, words.format(ours[first].mean(), plain[first].mean()), gaps)


def _clutter(rate: float) -> str:
    return f"{rate:g} false alarms a frame"


def hidden_sentence(found: CrowdResults) -> str:
    """Errors and biases of Σ w with a constant p_D, with hiders that are found, and true ones; and
    what follows for the hiders that are found.
    """
    clutter = found.rates[0]
    constant, hidden, true = (
        f"GM-PHD, rates{name}" for name in ("", ", occlusion", ", true hiders")
    )
    lines = []
    for words, name in (
        ("With the paper's constant p_D it is", constant),
        ("With the people found as hiders it is", hidden),
        ("With the true people as hiders it is", true),
    ):
        error = found.errors(name, clutter, "mass").mean()
        bias = found.biases(name, clutter, "mass").mean()
        lines.append(f"{words} {error:.2f} (bias {bias:+.2f}).")
    gaps = found.errors(constant, clutter, "mass") - found.errors(hidden, clutter, "mass")
    lower = decided(gaps.tolist())
    verdict = {
        True: "So p_D(x) with the people found lowers the error.",
        False: "So p_D(x) with the people found raises the error.",
        None: "So p_D(x) with the people found changes the error by no more than its own error.",
    }[lower]
    return "\n".join([*lines, verdict])


def _rows(
    results: Mapping[CrowdRun, CrowdCounts], clutter: float, people: F8, groups: F8, seeds: int
) -> list[tuple[object, ...]]:
    """A row for the raw detections and one for each filter: means over seeds with standard
    errors.
    """
    first = [results[CrowdRun(next(iter(FILTERS)), clutter, seed)] for seed in range(seeds)]
    raw = np.array([np.abs(o.raw - people).mean() for o in first])
    steps = np.array([np.abs(np.diff(o.raw)).mean() for o in first])
    rows: list[tuple[object, ...]] = [
        (clutter, "raw detections", _pm(raw), "", 1.0, _pm(steps), "", "", "", "")
    ]
    for name in FILTERS:
        runs = [results[CrowdRun(name, clutter, seed)] for seed in range(seeds)]
        mass = np.array([np.abs(o.mass - people).mean() for o in runs])
        rounded = np.array([np.abs(o.rounded - people).mean() for o in runs])
        states = np.array([np.abs(o.states - people).mean() for o in runs])
        grouped = np.array([np.abs(o.groups[USUAL_WEIGHT] - groups).mean() for o in runs])
        jumps = np.array([np.abs(np.diff(o.mass)).mean() for o in runs])
        biases = (
            f"{np.mean([(each - people).mean() for each in of]):+.2f}"
            for of in ([o.mass for o in runs], [o.rounded for o in runs])
        )
        bias, bias_rounded = biases
        share = float(mass.mean() / raw.mean())
        people_cells = (_pm(mass), bias, share, _pm(jumps), _pm(rounded), bias_rounded)
        rows.append((clutter, name, *people_cells, _pm(states), _pm(grouped)))
    return rows


def _pm(values: F8) -> str:
    return with_error(values.tolist(), 2)


def recall() -> float:
    """The expected share of the annotated people that the drop model detects."""
    annotated = truth()
    boxes = [annotated.xyxy[annotated.frame == number] for number in np.unique(annotated.frame)]
    return float(np.concatenate([FREE * (1 - FALL * covered(each)) for each in boxes]).mean())


def pictures(
    results: Mapping[CrowdRun, CrowdCounts],
    people: F8,
    groups: F8,
    found: Mapping[int, Groups],
    true: Mapping[int, GaussianMixture],
    out: Path,
) -> None:
    """Draw E13's two figures with E13's own filter: counts over time, and contours with truth and
    detections on the ground at the pictured frames.
    """
    plt = pyplot()
    job = CrowdRun("GM-PHD", CLUTTER[0], 0)
    frames = np.arange(1, INFO.frames + 1)
    figure, axes = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    axes[0].plot(frames, results[job].raw, color="0.7", lw=0.8, label="detections")
    axes[0].plot(frames, people, "k", lw=1.5, label="truth")
    axes[0].plot(frames, results[job].mass, "C0", lw=1, label="Σ w")
    axes[0].plot(frames, results[job].rounded, "C1", lw=1, label="Σ round(w)")
    axes[0].set(ylabel="people")
    axes[1].plot(frames, groups, "k", lw=1.5, label="truth")
    for k, (weight, found_groups) in enumerate(zip(WEIGHTS, results[job].groups, strict=True)):
        axes[1].plot(frames, found_groups, f"C{k}", lw=1, label=f"components from {weight:g}")
    axes[1].set(xlabel="frame", ylabel="groups")
    for axis in axes:
        axis.legend(fontsize=8, ncols=4, loc="upper center")
        axis.grid(alpha=0.3)
        axis.set_ylim(0, axis.get_ylim()[1] * 1.2)
    figure.savefig(out / "e13-counts.png", dpi=110)
    figure, axes = plt.subplots(
        1, len(PICTURED), figsize=(13, 4.6), sharey=True, layout="constrained"
    )
    camera = read_camera(camera_file())
    for number, (mixture, step) in enumerate(run(job), 1):
        if number not in PICTURED:
            continue
        axis = axes[PICTURED.index(number)]
        groups = Grouping().groups(mixture)
        for group in range(len(groups.count)):
            for line in Contours().of(mixture, groups.label == group):
                axis.plot(*line, color=f"C{group % 10}", lw=1.5)
            axis.annotate(
                f"{groups.count[group]:.1f}",
                groups.mean[:2, group],
                color=f"C{group % 10}",
                fontsize=8,
            )
        axis.plot(*camera.ground(feet(step.detections.xyxy)), "kx", ms=5, label="detections")
        axis.plot(*true[number].mean[:2], "o", ms=5, mfc="none", mec="0.5", label="truth")
        axis.set(
            title=f"frame {number}: {len(found[number].count)} groups, {len(groups.count)} found",
            xlabel="m",
            aspect="equal",
        )
        axis.set(xlim=(-16, -2), ylim=(-18, 11))
    axes[0].legend(fontsize=8, loc="upper left")
    axes[0].set_ylabel("m")
    figure.savefig(out / "e13-groups.png", dpi=110)
