"""A choice among a few settings, judged on sequences that had no part in it.

The best of several candidates looks better than it is: chance helped it to win. So each sequence is
left out in turn, the candidate that is best on the others is chosen, and scored on the one that was
left out. The mean of these scores is what the choice is worth on sequences that nobody has seen.

Of one sequence nothing else is left: its frames are divided into parts, one after the other, and
each part is left out in turn. It is tracked as a whole, and scored part by part.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.compare.case_files import existing, is_sequence, is_video
from phdtrack.compare.plans import Case, Plan, Run
from phdtrack.compare.runs import TRACKS, ComparedRun, Comparison, run_input
from phdtrack.compare.statistics import Interval, interval
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks, read_truth
from phdtrack.metrics.counts import count
from phdtrack.metrics.labelled import in_frames
from phdtrack.metrics.matching import pair_frames
from phdtrack.metrics.scores import scores_of
from phdtrack.parallel import Failed
from phdtrack.types import F8, I8, Truth

TUNED_SCORES = ("HOTA", "MOTA", "IDF1")
"""The scores that can be chosen by."""
DEFAULT = "default"
PARTS = 5
"""The parts into which a single sequence is divided."""
_PMB = "pmb"
# Annotated frames of a part: fewer hardly hold a track.
_FEWEST_FRAMES = 5
_NO_TRUTH = "Every sequence needs them: gt/gt.txt in its folder, or --truth."


class Candidate(NamedTuple):
    """Settings to choose among: a name, settings as a variant of `phdtrack compare` has them, and
    the kind of sequence that they are meant for.
    """

    name: str
    sets: str
    meant_for: str


_CALM = Candidate("calm", "motion.acceleration=0.0025", "objects that move evenly")
_LOOSE = Candidate("loose-boxes", "sensor.box_noise=0.2", "boxes that change from frame to frame")
CANDIDATES = (
    Candidate("agile", "motion.acceleration=0.01", "objects that turn and brake at once"),
    _CALM,
    _LOOSE,
    Candidate("exact-boxes", "sensor.box_noise=0.1", "boxes that fit tightly"),
    Candidate("hidden-longer", "filter.mean_occluded_time=1.0", "long occlusions"),
    Candidate("never-hidden", "filter.mean_visible_time=0.0", "views without occlusion"),
    Candidate("scores-unused", "detection_scores.kind=none", "scores that tell nothing"),
    Candidate("mot15", "preset=mot15", "weak detectors of pedestrians"),
)
"""The settings that are tried besides the default: few, because each more makes the choice
riskier."""
# Other filters are told what the PMB filter learns: how often objects are detected, and what is
# a false alarm. Their opposites (agile, exact boxes, p_D 0.6, a clutter of 0.1 per detection) lose
# 0.02 to 0.03 of HOTA on average over four filters and six real sequences, on which they are hardly
# ever the best (measured once, by a script that is not kept).
_OTHER_FILTERS = (
    _CALM,
    _LOOSE,
    Candidate("seldom-missed", "sensor.detection_probability=0.95", "detectors that miss little"),
    Candidate("much-clutter", "clutter.clutter_per_detection=1.5", "many false alarms"),
)


def candidates(filter_name: str) -> tuple[Candidate, ...]:
    """The settings to try with a filter besides its default.

    Parameters
    ----------
    filter_name : as ``--filter`` has it.
    """
    if filter_name == _PMB:
        return CANDIDATES
    if filter_name == "none":
        raise InputError(
            "the filter none has no settings to choose",
            where="--filter none",
            cure="Choose another one, for example pmb.",
        )
    return _OTHER_FILTERS


@dataclass(frozen=True, slots=True)
class Fold:
    """A sequence, or a part of one, that was left out.

    Attributes
    ----------
    sequence : its name.
    chosen : the best candidate on the others.
    score, default : the scores of the chosen one, and of the default, on it.
    """

    sequence: str
    chosen: str
    score: float
    default: float

    @property
    def gain(self) -> float:
        """The gain of the choice against the default; negative for a loss."""
        return self.score - self.default


@dataclass(frozen=True, slots=True)
class Tuning:
    """The scores of all candidates, and what choosing among them is worth.

    Attributes
    ----------
    score : name of the score.
    sequences, names : of the sequences, and of the candidates; the default comes first.
    table : (candidates, sequences) scores.
    folds : each sequence, left out.
    parts_of : the only sequence, if ``sequences`` are parts of it; else empty.
    """

    score: str
    sequences: tuple[str, ...]
    names: tuple[str, ...]
    table: F8
    folds: tuple[Fold, ...]
    parts_of: str = ""

    @property
    def best(self) -> str:
        """The candidate with the highest mean over all sequences."""
        return self.names[_best(self.table)]

    @property
    def chosen(self) -> str:
        """The candidate to use: the best one if choosing gains anything on sequences that are left
        out, else the default.
        """
        return self.best if self.gain.mean > 0 else DEFAULT

    @property
    def gain(self) -> Interval:
        """The mean gain on sequences that are left out, with its interval over sequences."""
        return interval([fold.gain for fold in self.folds])

    @property
    def apparent(self) -> float:
        """The gain of the best candidate on the sequences that it was chosen on."""
        means = self.table.mean(axis=1)
        return float(means.max() - means[0])

    @property
    def worst(self) -> Fold:
        """The sequence, left out, on which the choice lost most or gained least."""
        return min(self.folds, key=lambda fold: fold.gain)

    def mean(self, name: str) -> Interval:
        """The mean of a candidate, with its interval over sequences."""
        return interval(self.table[self.names.index(name)].tolist())

    def ahead(self, name: str) -> Interval:
        """The mean difference of a candidate to the default, sequence by sequence."""
        return interval((self.table[self.names.index(name)] - self.table[0]).tolist())

    def times(self, name: str) -> int:
        """How often a candidate was chosen, with one sequence left out."""
        return sum(fold.chosen == name for fold in self.folds)


def inputs(words: Sequence[str]) -> tuple[list[str], list[tuple[Path, Path]]]:
    """The sequences and the pairs of truth and detections that a user names.

    Folders and videos are sequences. Files come in turns, a truth and the detections, or the video,
    of the same sequence. Two folders that are no sequences hold truths and detections, with files
    of the same names.

    Parameters
    ----------
    words : paths as the user wrote them.

    Raises
    ------
    InputError : files without a partner, or files among folders.
    """
    paths = [existing(word) for word in words]
    if all(path.is_dir() or is_video(path) for path in paths):
        if len(paths) == 2 and all(one.is_dir() and not is_sequence(one) for one in paths):
            return [], _pairs_in(*paths)
        return list(words), []
    if any(path.is_dir() for path in paths):
        raise InputError(
            "expected either files or folders, got both",
            where=" ".join(words),
            cure="Name folders of sequences, or in turns a file of truth and one of detections.",
        )
    if len(paths) % 2:
        raise InputError(
            f"expected a file of detections for each file of truth, got {len(paths)} in all",
            where=" ".join(words),
            cure="Name them in turns: TRUTH DETECTIONS, then those of the next sequence.",
        )
    return [], list(zip(paths[::2], paths[1::2], strict=True))


def _pairs_in(truths: Path, detections: Path) -> list[tuple[Path, Path]]:
    """The files of two folders, by their names without the ending."""
    first, second = (
        {file.stem: file for file in sorted(folder.iterdir()) if file.is_file()}
        for folder in (truths, detections)
    )
    if not first or not second:
        raise InputError(
            "there are no files in it, nor is it a sequence",
            where=detections if first else truths,
            cure="Name folders as MOTChallenge's, with gt/gt.txt and det/det.txt; or a folder of"
            " truths and one of detections, with files of the same names.",
        )
    alone = first.keys() ^ second.keys()
    if alone:
        name = min(alone)
        raise InputError(
            f"{(first | second)[name]} has no partner of the same name",
            where=detections if name in first else truths,
            cure="A truth and its detections have the same name, as a/street.txt and b/street.txt.",
        )
    return [(first[name], second[name]) for name in first]


def check_truth(plan: Plan) -> None:
    """Raise `InputError` unless every sequence has annotated objects, and a single one enough to
    divide it.

    Parameters
    ----------
    plan : the sequences.
    """
    for case in plan.cases:
        if case.truth is None:
            raise InputError("there are no annotated objects", where=case.name, cure=_NO_TRUTH)
    if len({case.sequence for case in plan.cases}) > 1:
        return
    for case in plan.cases:
        assert case.truth is not None
        truth = read_truth(case.truth, conventions=case.reading[0], notices=[])
        annotated = len(_annotated_frames(truth))
        least = PARTS * _FEWEST_FRAMES
        if annotated < least:
            raise InputError(
                f"expected at least {least} annotated frames to divide one sequence into {PARTS}"
                f" parts, got {annotated}",
                where=case.name,
                cure="Name more sequences: then each one is left out in turn.",
            )


def _annotated_frames(truth: Truth) -> I8:
    """The numbers of the frames in which objects are annotated, ascending."""
    return np.unique(truth.frame[~truth.distractor])


def tuning(comparison: Comparison, score: str) -> Tuning:
    """The worth of choosing among the methods of a comparison, of which the first is the default.

    Parameters
    ----------
    comparison : of a plan that `check_truth` accepts; a single sequence is divided into parts.
    score : one of `TUNED_SCORES`.

    Raises
    ------
    InputError : a run failed, or there is nothing to score in a sequence or part.
    """
    sequences = tuple(dict.fromkeys(case.sequence for case in comparison.plan.cases))
    parts_of = sequences[0] if len(sequences) == 1 else ""
    parts = {one.place: _parts(comparison, one) for one in comparison.plan.cases if parts_of}
    values = dict[tuple[str, str], list[float]]()
    for run in comparison.plan.runs:
        result = comparison.result(run)
        if isinstance(result, Failed):
            raise InputError(f"the run failed: {result.reason}", where=str(run))
        if parts_of:
            found = _scores_of_parts(comparison, run, parts[run.case.place], score)
        else:
            found = {run.case.sequence: _score(result, score)}
        for name, value in found.items():
            if not math.isfinite(value):
                raise InputError(f"there is no {score}", where=f"{run}, {name}", cure=_NO_TRUTH)
            values.setdefault((run.method.name, name), []).append(value)
    judged = tuple(dict.fromkeys(name for _, name in values))
    names = tuple(method.name for method in comparison.plan.methods)
    means = {key: float(np.mean(each)) for key, each in values.items()}
    return replace(of_scores(score, judged, names, means), parts_of=parts_of)


def _score(result: ComparedRun, score: str) -> float:
    """The score of a whole sequence; not a number without truth."""
    return math.nan if result.scores is None else float(getattr(result.scores, score))


class _Parts(NamedTuple):
    """The truth of a sequence, and the frames of each part that are scored, by its name."""

    truth: Truth
    frames: Mapping[str, I8]


def _parts(comparison: Comparison, case: Case) -> _Parts:
    """The parts of a sequence, with as many annotated frames each."""
    plan = comparison.plan
    read = run_input(Run(case, plan.rates[0], plan.methods[0], plan.seeds[0]), comparison.folder)
    assert read.truth is not None
    annotated = _annotated_frames(read.truth)
    scored = read.labelled
    if not len(scored):
        scored = np.arange(1, read.info.frames + 1)
    begins = [part[0] for part in np.array_split(annotated, PARTS)[1:]]
    edges = [int(scored[0]), *map(int, begins), max(int(scored[-1]), int(annotated[-1])) + 1]
    return _Parts(
        read.truth,
        {
            f"frames {first}-{end - 1}": scored[(scored >= first) & (scored < end)]
            for first, end in pairwise(edges)
        },
    )


def _scores_of_parts(
    comparison: Comparison, run: Run, parts: _Parts, score: str
) -> dict[str, float]:
    """The score of each part of a sequence that was tracked as a whole."""
    tracks = read_tracks(comparison.folder / run.place / TRACKS, notices=[])
    iou = comparison.plan.iou
    found = dict[str, float]()
    for name, frames in parts.frames.items():
        truth, rows = in_frames(parts.truth, tracks, frames)
        counts = count(pair_frames(truth, rows, len(frames)), iou)
        found[name] = float(getattr(scores_of(counts, iou), score))
    return found


def of_scores(
    score: str,
    sequences: Sequence[str],
    names: Sequence[str],
    values: Mapping[tuple[str, str], float],
) -> Tuning:
    """The worth of choosing, from scores.

    Parameters
    ----------
    score : its name.
    sequences, names : of sequences and candidates; the default comes first.
    values : the score by candidate and sequence; higher is better.
    """
    table = np.array([[values[name, sequence] for sequence in sequences] for name in names])
    folds = list[Fold]()
    for k, sequence in enumerate(sequences):
        best = _best(np.delete(table, k, axis=1))
        folds.append(Fold(sequence, names[best], float(table[best, k]), float(table[0, k])))
    return Tuning(score, tuple(sequences), tuple(names), table, tuple(folds))


def _best(table: F8) -> int:
    """The row with the highest mean; of equal ones the first, so that the default stays."""
    return int(np.argmax(table.mean(axis=1)))
