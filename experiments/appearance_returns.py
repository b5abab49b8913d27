"""A simulation of people who are hidden and come back, for `experiments.appearance`.

People walk about in a picture. After some 20 s each of them is hidden for a given time, walks on
meanwhile, and comes back with the probability `BACK`; else a stranger appears anywhere instead.
Some wear what another one wears. Embeddings have the middle quality of the script that makes those
of real sequences: a weighted sum of two of its results, one for what people wear and one for
themselves, has the same errors, and those who wear the same look alike up to the angle `ALIKE`.

Every detection has a known person, so each identity that `Tracker.returns` has given back is right
or wrong. So is the identity that somebody has `SETTLED` seconds after appearing.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from experiments.appearance_inputs import F4, embeddings_of
from experiments.appearance_runs import USUAL
from experiments.common import Options, filled, in_parallel, need_data, pyplot, table
from phdtrack import Tracker, Tracks
from phdtrack.arrays import intersection
from phdtrack.types import F8, I8, Bool, Detections, Return

HIDDEN = (2.0, 5.0, 15.0, 60.0)
PEOPLE = (5, 15, 30)
SEEDS = 4
# The first seed: the law was chosen with those below it.
FIRST = 101
SECONDS = 400.0
FPS = 6.0
SIZE = (1920, 1080)
BOX = (60.0, 150.0)
# Pixels a second, and mean seconds that somebody is there.
SPEED = 90.0
VISIBLE = 20.0
# The probability that who is hidden comes back, and that somebody wears what another one wears, who
# then look alike up to this angle, degrees.
BACK = 0.5
DRESSED_ALIKE = 0.3
ALIKE = 20.0
# Of the detector: p_D, deviation of the edges in shares of the box, false boxes a frame.
P_DETECT = 0.95
NOISE = 0.03
CLUTTER = 0.2
# Seconds after which an identity is judged.
SETTLED = 4.0
# Claimed probabilities that are pooled.
BINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
PICTURE = "appearance-calibration.png"


@dataclass(frozen=True, slots=True)
class HiddenRun:
    """A simulation: seconds for which people are hidden, how many are there or hidden, and seed."""

    hidden: float
    people: int
    seed: int
    seconds: float = SECONDS


@dataclass(frozen=True, slots=True, eq=False)
class Walks:
    """The people of a simulation.

    Attributes
    ----------
    frame, person : (M,) of each box that is visible, ascending by frame.
    xyxy : (M, 4) the boxes.
    wears : (P,) by person, the person whose clothes these are.
    appearances : frame, person, and whether this one was there before, of all after the start.
    """

    frame: I8
    person: I8
    xyxy: F8
    wears: I8
    appearances: tuple[tuple[int, int, bool], ...]


@dataclass(frozen=True, slots=True)
class Verdicts:
    """The outcome of a simulation.

    Attributes
    ----------
    claimed : the probability of each identity that was given back online, and whether it was right.
    kept : of online and corrected rows, for each person who came back whether the identity is that
        of before.
    mistaken : the same for each stranger, whether the identity is that of somebody who is gone.
    """

    claimed: tuple[tuple[float, bool], ...]
    kept: tuple[tuple[bool, ...], tuple[bool, ...]]
    mistaken: tuple[tuple[bool, ...], tuple[bool, ...]]


def walks(run: HiddenRun) -> Walks:
    """The people of a simulation, and where they are."""
    rng = np.random.default_rng([run.seed, run.people, round(10 * run.hidden)])
    frames = round(run.seconds * FPS)
    wears = list[int]()
    appearances = list[tuple[int, int, bool]]()
    rows = list[tuple[I8, I8, F8]]()

    def newcomer() -> int:
        """A new person, who may wear what an earlier one wears."""
        person = len(wears)
        alike = person > 0 and rng.random() < DRESSED_ALIKE
        wears.append(wears[int(rng.integers(person))] if alike else person)
        return person

    for _ in range(run.people):
        path = random_walk(frames, rng)
        person = newcomer()
        # At the start some are hidden, as at any other time.
        number = 1 - round(rng.uniform(0, VISIBLE + run.hidden) * FPS)
        while number <= frames:
            until = number + max(round(rng.exponential(VISIBLE) * FPS), 1)
            here = np.arange(max(number, 1), min(until, frames + 1))
            rows.append((here, np.full(len(here), person), path[here - 1]))
            number = until + round(run.hidden * FPS)
            back = bool(rng.random() < BACK)
            if not back:
                person = newcomer()
                path = random_walk(frames, rng)
            if 1 < number <= frames:
                appearances.append((number, person, back and until > 1))
    frame = np.concatenate([each[0] for each in rows])
    order = np.argsort(frame, kind="stable")
    person = np.concatenate([each[1] for each in rows])[order]
    centre = np.concatenate([each[2] for each in rows])[order]
    half = np.array(BOX) / 2
    boxes = np.column_stack([centre - half, centre + half])
    return Walks(frame[order], person, boxes, np.array(wears), tuple(sorted(appearances)))


def random_walk(frames: int, rng: np.random.Generator) -> F8:
    """(frames, 2) a walk from one random place in the picture to another."""
    margin = np.array(BOX) / 2
    place = rng.uniform(margin, np.array(SIZE) - margin)
    out = np.zeros((0, 2))
    while len(out) < frames:
        goal = rng.uniform(margin, np.array(SIZE) - margin)
        steps = max(math.ceil(math.dist(place, goal) / SPEED * FPS), 1)
        part = np.arange(1, steps + 1)[:, None] / steps
        out = np.vstack([out, place + part * (goal - place)])
        place = goal
    return out[:frames]


def detected(scene: Walks, rng: np.random.Generator) -> tuple[I8, I8, F8]:
    """Frame, person (−1: false) and box of detections, ascending by frame. Who is covered by more
    than a half is not detected.
    """
    seen = rng.random(len(scene.frame)) < P_DETECT
    for number in np.unique(scene.frame):
        here = np.flatnonzero(scene.frame == number)
        seen[here[covered(scene.xyxy[here])]] = False
    noise = NOISE * np.tile(BOX, 2)
    found = scene.xyxy[seen] + noise * rng.standard_normal((np.count_nonzero(seen), 4))
    last = int(scene.frame[-1])
    false = rng.poisson(CLUTTER * last)
    corner = rng.uniform(0, np.array(SIZE) - BOX, (false, 2))
    frame = np.concatenate([scene.frame[seen], rng.integers(1, last + 1, false)])
    person = np.concatenate([scene.person[seen], np.full(false, -1)])
    boxes = np.vstack([found, np.column_stack([corner, corner + BOX])])
    order = np.argsort(frame, kind="stable")
    return frame[order], person[order], boxes[order]


def covered(boxes: F8) -> Bool:
    """(M,) boxes of which one whose lower edge is lower covers more than a half."""
    part = intersection(boxes, boxes) / (BOX[0] * BOX[1])
    part *= boxes[:, None, 3] < boxes[None, :, 3]
    found: Bool = part.max(axis=1) > 0.5
    return found


def worn_embeddings(scene: Walks, frame: I8, boxes: F8, seed: int) -> F4:
    """(M, D) embeddings of detections in which those who wear the same look alike."""
    by_clothes = _scripted(scene, scene.wears[scene.person], (frame, boxes), 2 * seed)
    by_person = _scripted(scene, scene.person, (frame, boxes), 2 * seed + 1)
    angle = math.radians(ALIKE)
    out: F4 = math.cos(angle) * by_clothes + math.sin(angle) * by_person
    return out.astype(np.float32)


def _scripted(scene: Walks, identity: I8, found: tuple[I8, F8], seed: int) -> F4:
    """(M, D) the script's embeddings of detections on objects with these identities."""
    with tempfile.TemporaryDirectory() as folder:
        truth = Path(folder) / "gt.txt"
        detections = Path(folder) / "det.txt"
        for path, frame, name, boxes in (
            (truth, scene.frame, identity, scene.xyxy),
            (detections, found[0], np.full(len(found[0]), -1), found[1]),
        ):
            rows = np.column_stack(
                [frame, name, boxes[:, :2], boxes[:, 2:] - boxes[:, :2], np.ones(len(frame))]
            )
            np.savetxt(path, rows, delimiter=",", fmt="%.3f")
        bench = need_data().parent / "bench"
        return embeddings_of((truth, detections), bench, USUAL, seed, FPS)


def simulated(run: HiddenRun) -> Verdicts:
    """Simulate, track, and judge."""
    scene = walks(run)
    frame, person, boxes = detected(scene, np.random.default_rng([run.seed, 1]))
    looks = worn_embeddings(scene, frame, boxes, run.seed)
    last = round(run.seconds * FPS)
    ends = np.searchsorted(frame, np.arange(1, last + 2))
    tracker = Tracker(SIZE, fps=FPS)
    rows = []
    for k in range(last):
        here = slice(ends[k], ends[k + 1])
        found = Detections.of(boxes[here], None, None, looks[here])
        rows.append(tracker.update(found, frame=k + 1))
    online = Tracks.concatenate([*rows, tracker.flush()])
    outputs = (online, tracker.tracks())
    judged = [judge(scene, tracks, person_of(tracks, ends, person)) for tracks in outputs]
    return Verdicts(
        tuple(_claim(each, ends, person) for each in tracker.returns),
        (judged[0][0], judged[1][0]),
        (judged[0][1], judged[1][1]),
    )


def person_of(tracks: Tracks, ends: I8, person: I8) -> I8:
    """(N,) the person on whose detection each row is; −1 without any."""
    found = np.full(len(tracks), -1)
    on = tracks.detection >= 0
    found[on] = person[ends[tracks.frame[on] - 1] + tracks.detection[on]]
    return found


def _claim(given: Return, ends: I8, person: I8) -> tuple[float, bool]:
    """The claimed probability of an identity that was given back, and whether it is right."""
    one, other = (person[ends[frame - 1] + row] for frame, row in (given.ended, given.began))
    return given.odds / (1 + given.odds), bool(one == other >= 0)


def judge(scene: Walks, tracks: Tracks, whose: I8) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
    """For each person who came back, whether the identity `SETTLED` seconds later is that of
    before; for each stranger, whether it is that of somebody who is gone. Those who have none then
    are left out.
    """
    kept = list[bool]()
    mistaken = list[bool]()
    for number, person, back in scene.appearances:
        after = np.flatnonzero((whose == person) & (tracks.frame >= number + SETTLED * FPS))
        soon = after[tracks.frame[after] < number + 2 * SETTLED * FPS]
        if not len(soon):
            continue
        identity = tracks.identity[soon[tracks.frame[soon].argmin()]]
        before = np.flatnonzero((tracks.frame < number) & (whose >= 0))
        if back:
            own = before[whose[before] == person]
            if len(own):
                kept.append(bool(tracks.identity[own[tracks.frame[own].argmax()]] == identity))
            continue
        same = before[tracks.identity[before] == identity]
        there = scene.person[(scene.frame == number)]
        gone = len(same) and whose[same[tracks.frame[same].argmax()]] not in there
        mistaken.append(bool(gone))
    return tuple(kept), tuple(mistaken)


def interval(right: int, number: int) -> tuple[float, float]:
    """The 95 % interval of a share (Clopper and Pearson)."""
    found = binomtest(right, number).proportion_ci()
    return float(found.low), float(found.high)


def section(options: Options) -> str:
    """The part of the page, and its picture."""
    hidden = (2.0, 15.0) if options.quick else HIDDEN
    people = (5,) if options.quick else PEOPLE
    seconds = 60.0 if options.quick else SECONDS
    jobs = [
        HiddenRun(time, number, seed, seconds)
        for time in hidden
        for number in people
        for seed in range(FIRST, FIRST + options.number(SEEDS, 1))
    ]
    found = in_parallel(simulated, jobs, "people who come back", options)
    claims = [claim for one in found for claim in one.claimed]
    calibrated = calibration(claims)
    _draw(calibrated, options.folder / PICTURE)
    return filled(
        "appearance_returns",
        seeds=options.number(SEEDS, 1),
        first=FIRST,
        seconds=f"{seconds:g}",
        fps=f"{FPS:g}",
        visible=f"{VISIBLE:g}",
        back=f"{BACK:g}",
        alike=f"{DRESSED_ALIKE:g}",
        angle=f"{ALIKE:g}",
        settled=f"{SETTLED:g}",
        cells=_cells_table(jobs, found),
        outside=_cells_verdict(jobs, found),
        calibration=_calibration_table(calibrated),
        verdict=verdict(claims, calibrated),
        picture=PICTURE,
    )


# A bin's ends, the mean claimed probability in it, how many were right, and of how many.
Bin = tuple[float, float, float, int, int]


def calibration(claims: Sequence[tuple[float, bool]]) -> list[Bin]:
    """The bins that have claims."""
    out = []
    for low, high in itertools.pairwise(BINS):
        inside = [claim for claim in claims if low < claim[0] <= high]
        if inside:
            mean = float(np.mean([claim[0] for claim in inside]))
            out.append((low, high, mean, sum(claim[1] for claim in inside), len(inside)))
    return out


def _calibration_table(bins: Sequence[Bin]) -> str:
    rows = []
    for low, high, mean, right, number in bins:
        ends = interval(right, number)
        share = f"{right / number:.3f} ({ends[0]:.3f} to {ends[1]:.3f})"
        rows.append((f"{low:g} to {high:g}", number, f"{mean:.3f}", share))
    return table(("claimed", "identities", "mean claim", "share right"), rows)


def verdict(claims: Sequence[tuple[float, bool]], bins: Sequence[Bin]) -> str:
    """What the claims were worth, in a sentence or two."""
    if not claims:
        return "No identity was given back."
    right = sum(one for _, one in claims)
    mean = float(np.mean([claim for claim, _ in claims]))
    parts = [
        f"Of {len(claims)} identities given back online {right} were right"
        f" ({100 * right / len(claims):.1f} %), where {100 * mean:.1f} % were claimed."
    ]
    sure = [one for claim, one in claims if claim >= 0.9]
    if sure:
        parts.append(
            f"Of the {len(sure)} at odds of 9:1 or more {100 * np.mean(sure):.1f} % were right."
        )
    outside = []
    for low, high, mean_claim, good, number in bins:
        ends = interval(good, number)
        if not ends[0] <= mean_claim <= ends[1]:
            outside.append(f"{low:g} to {high:g}")
    parts.append(
        f"The mean claim is outside of the interval for claims of {', '.join(outside)}."
        if outside
        else "The mean claim of each row is within its interval."
    )
    return " ".join(parts)


def _cells_table(jobs: Sequence[HiddenRun], found: Sequence[Verdicts]) -> str:
    """For each time and number of people what became of the identities."""
    rows = list[list[object]]()
    for time, people in dict.fromkeys((job.hidden, job.people) for job in jobs):
        those = [
            one
            for job, one in zip(jobs, found, strict=True)
            if (job.hidden, job.people) == (time, people)
        ]
        claims = [claim for one in those for claim in one.claimed]
        right = sum(one for _, one in claims)
        claimed = f"{np.mean([claim for claim, _ in claims]):.2f}" if claims else "–"
        cells = []
        for k in (0, 1):
            cells.append(_share([each for one in those for each in one.kept[k]]))
            cells.append(_share([each for one in those for each in one.mistaken[k]]))
        rows.append([f"{time:g} s", people, right, len(claims) - right, claimed, *cells])
    return table(
        (
            "hidden",
            "people",
            "given back rightly",
            "wrongly",
            "mean claim",
            "own identity, online",
            "another's",
            "own identity, corrected",
            "another's",
        ),
        rows,
    )


def _cells_verdict(jobs: Sequence[HiddenRun], found: Sequence[Verdicts]) -> str:
    """The times and numbers of people whose mean claim is outside of the interval, in a
    sentence.
    """
    outside = []
    for time, people in dict.fromkeys((job.hidden, job.people) for job in jobs):
        claims = [
            claim
            for job, one in zip(jobs, found, strict=True)
            for claim in one.claimed
            if (job.hidden, job.people) == (time, people)
        ]
        if not claims:
            continue
        right = sum(one for _, one in claims)
        ends = interval(right, len(claims))
        mean = float(np.mean([claim for claim, _ in claims]))
        if not ends[0] <= mean <= ends[1]:
            word = "high" if mean > ends[1] else "low"
            outside.append(f"{people} people hidden for {time:g} s (too {word})")
    if not outside:
        return "The mean claim is within the 95 % interval of the share right in each of them."
    names = "; ".join(outside)
    return f"The mean claim is outside of the 95 % interval of the share right with {names}."


def _share(verdicts: Sequence[bool]) -> str:
    return f"{sum(verdicts)} of {len(verdicts)}"


def _draw(bins: Sequence[Bin], path: Path) -> None:
    """Draw the calibration: the share that is right against what was claimed."""
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(6, 4.5))
    axes.plot([0.4, 1], [0.4, 1], color="0.6", linewidth=1, label="as claimed")
    share = np.array([one[3] / one[4] for one in bins])
    ends = np.array([interval(one[3], one[4]) for one in bins]).reshape(-1, 2)
    claimed = [one[2] for one in bins]
    axes.errorbar(
        claimed,
        share,
        yerr=np.abs(ends.T - share),
        fmt="o",
        capsize=3,
        label="right, with 95 % interval",
    )
    for x, y, one in zip(claimed, share, bins, strict=True):
        axes.annotate(f"{one[4]}", (x, y), xytext=(7, -14), textcoords="offset points", fontsize=8)
    axes.set(
        xlabel="claimed probability", ylabel="share right", xlim=(0.45, 1.02), ylim=(0.35, 1.03)
    )
    axes.legend(loc="lower right", frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
