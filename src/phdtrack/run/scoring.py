"""The scores of a run whose objects are annotated, and doubts about the annotation."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from phdtrack.run.running import Progress, Run
from phdtrack.types import Tracks

if TYPE_CHECKING:
    from phdtrack.metrics import Scores


class RunScores(NamedTuple):
    """The scores of a run, None without truth, and sentences about a truth that may not fit."""

    scores: Scores | None = None
    doubts: tuple[str, ...] = ()


def score_run(run: Run, progress: Progress, tracks: Tracks) -> RunScores:
    """Score the frames that were tracked, or the labelled ones among them. Raises `InputError` for
    frames that are none.

    Parameters
    ----------
    run, progress : what was run, and how far it got.
    tracks : corrected tracks.
    """
    truth = run.options.truth
    if truth is None or not progress.summaries:
        return RunScores()
    # Loaded only if there is truth.
    from phdtrack.metrics import evaluate
    from phdtrack.metrics.agreement import other_reading
    from phdtrack.metrics.labelled import in_frames
    from phdtrack.run.scored_files import labelled_frames

    doubts = list(filter(None, [other_reading(truth, tracks)]))
    labelled = labelled_frames(run.options.labelled, truth, tracks, "--truth", doubts)
    first = run.inputs.source.first
    if not len(labelled):
        scores = evaluate(truth, tracks, frames=progress.last, first=first)
        return RunScores(scores, tuple(doubts))
    labelled = labelled[(labelled >= first) & (labelled <= progress.last)]
    if not len(labelled):
        return RunScores(None, (*doubts, "--labelled: none of these frames was tracked"))
    scores = evaluate(*in_frames(truth, tracks, labelled), frames=len(labelled))
    return RunScores(scores, tuple(doubts))
