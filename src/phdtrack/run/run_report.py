"""The report of a run: report.html, run.json, and sentences for people."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.detect import BACKGROUND
from phdtrack.files import write_text
from phdtrack.report import RunRecord, report_html, run_document, sentences, write_run
from phdtrack.report.object_list import HOUR, MINUTE, heatmap_csv, minutes_csv, objects_csv
from phdtrack.report.pages import doubts, lines
from phdtrack.run import directory as rundir
from phdtrack.run.confirmation import confirmation
from phdtrack.run.directory import RunDirectory
from phdtrack.run.running import Progress, Run
from phdtrack.run.scene_pass import SceneLesson
from phdtrack.run.scoring import RunScores
from phdtrack.types import Tracks

if TYPE_CHECKING:
    from phdtrack.metrics import Scores

_WHICH = (
    f"{rundir.TRACKS} holds the corrected tracks of the whole run, {rundir.ONLINE} the rows that"
    " were final frame by frame."
)
_LATEST = (
    "The source had no end: figures are of the whole run, charts of its last frames, paths of the"
    " last tracks."
)
_REUSED = (
    "The detections are those of an earlier run with the same detector; --detect-again detects"
    " anew."
)
_HIDDEN = (
    "In all pictures {} of detections and tracks are hidden; objects that were neither detected nor"
    " tracked are visible."
)
_ONE_PICTURE = (
    "one picture shows no motion, and the detector {} needs several: --detector person, or"
    " onnx:FILE for a network, finds objects in a single picture"
)
# Tracks that are known to be right are not doubted.
GOOD_MOTA = 0.5
_SHAKES = "The camera shakes: each picture was aligned with the scene before it was compared."


def write_report(
    run: Run,
    progress: Progress,
    tracks: Tracks,
    scored: RunScores,
    seconds: tuple[float, float],
    lesson: SceneLesson | None = None,
) -> tuple[dict[str, object], tuple[str, ...], tuple[str, ...]]:
    """Write report.html and run.json.

    Parameters
    ----------
    run, progress : what was run, and how far it got.
    tracks, scored : corrected tracks and their scores.
    seconds : of everything so far, and of what followed the loop.
    lesson : what a first pass has taught of the scene; None without one.

    Returns
    -------
    The content of run.json; a summary and warnings in sentences.
    """
    options = run.options
    scores = scored.scores
    record = replace(
        progress.recorder.record(tracks, options.about), names=run.names, tables=run.inputs.again
    )
    if progress.signs is not None:
        record = replace(record, doubtful=progress.signs.result())
    if run.inputs.descriptors.name:
        worth = progress.recorder.appearance.worth(
            run.inputs.descriptors.name, progress.tracker.returns, record.numbers, record.times
        )
        worth = replace(worth, exchanged=len(progress.tracker.exchanges))
        record = replace(record, appearance=worth)
    confirmed = _confirmation(run, progress)
    wrong = progress.scene_warnings
    if scores is None or scores.MOTA < GOOD_MOTA:
        wrong = (*wrong, *doubts(record))
    about = replace(
        options.about,
        seconds=seconds[0],
        tracking_seconds=progress.seconds,
        finishing_seconds=seconds[1],
        left_out=progress.skipped,
        scores=_score_values(scores),
        warnings=(*_problems(run, progress), *scored.doubts, *wrong, *confirmed[1:]),
        notes=(*confirmed[:1], *_notes(run, progress)),
    )
    reports = [observer.report() for observer in run.observers]
    if lesson is not None:
        reports.append(lesson.report(record.background))
    section = "\n".join(report.section for report in reports)
    record = replace(record, about=replace(about, sections=section))
    inputs = {"input": dict(options.read)}
    configuration = dict(options.configuration)
    with progress.writing():
        page = report_html(record, configuration | inputs)
        write_text(run.directory.file(rundir.REPORT), page)
    _write_objects(run, progress, record)
    complete = progress.ended is None
    document = run_document(record, configuration) | {"complete": complete} | inputs
    document |= _told(progress, record)
    with progress.writing():
        more = [report.document for report in reports]
        document = finish_document(document, run.directory, *more)
    if complete and progress.ended is None:
        run.directory.sweep()
    summary = list(sentences(record))
    if progress.reused:
        summary.insert(0, _REUSED)
    summary += [sentence for report in reports for sentence in report.sentences]
    summary += _asked(run, progress)
    unwritten = [str(error) for error in progress.unwritten if error is not progress.ended]
    return document, tuple(summary), (*about.warnings, *unwritten)


def _write_objects(run: Run, progress: Progress, record: RunRecord) -> None:
    """Write the objects, the minutes, the hours and the map, unless the source has no end: then
    only its last frames are known.
    """
    if record.tables:
        found = record.objects
        with progress.writing():
            write_text(run.directory.file(rundir.OBJECTS), objects_csv(found))
            for name, width in ((rundir.MINUTES, MINUTE), (rundir.HOURS, HOUR)):
                rows = minutes_csv(record.objects_during(found, width))
                write_text(run.directory.file(name), rows)
            places = heatmap_csv(record.tracks, record.info)
            write_text(run.directory.file(rundir.HEATMAP), places)


def _asked(run: Run, progress: Progress) -> Iterator[str]:
    """Sentences about the user's settings: boxes that they left out, and the preset."""
    if progress.tracker.left_out.unwanted:
        yield progress.tracker.left_out.as_asked
    if "preset" in run.options.configuration:
        yield f"Settings: preset {run.options.configuration['preset']}."


def _told(progress: Progress, record: RunRecord) -> dict[str, object]:
    """Events of the run, for run.json."""
    told: dict[str, object] = {"boxes_left_out": progress.tracker.left_out._asdict()}
    if record.appearance is not None:
        told["appearance"] = record.appearance.as_dict()
        told["identities_given_back"] = [
            each._replace(odds=round(each.odds, 2))._asdict() for each in record.appearance.returns
        ]
        told["identities_exchanged"] = [
            {
                "identities": list(each.identities),
                "frame": each.frame,
                "odds": round(each.odds, 2),
            }
            for each in progress.tracker.exchanges
        ]
    if progress.resumed:
        told["resumed_from_frame"] = progress.resumed
    if progress.reused:
        told["detections_reused"] = progress.reused
    return told


def finish_document(
    document: dict[str, object], directory: RunDirectory, *more: dict[str, object]
) -> dict[str, object]:
    """Write run.json, and give its content.

    Parameters
    ----------
    document, more : its content, and that of observers.
    directory : of the run; its files are added.
    """
    run = directory.file(rundir.RUN)
    files = {file.name: str(file) for file in directory.written()} | {run.name: str(run)}
    document = document | {"directory": str(directory.path), "files": files}
    for part in more:
        document |= part
    write_run(run, document)
    return document


def _confirmation(run: Run, progress: Progress) -> tuple[str, ...]:
    """A note on the confirmation of tracks, and a warning if it takes long."""
    boxes = [summary.detections.xyxy for summary in progress.summaries]
    return confirmation(
        run.classes.usual, run.inputs.info, np.concatenate([np.zeros((0, 4)), *boxes])
    )


def _score_values(scores: Scores | None) -> tuple[tuple[str, float], ...]:
    """Names and values of the scores, NaN for those that are undefined."""
    if scores is None:
        return ()
    values = scores.as_dict().items()
    return tuple((name, math.nan if value is None else value) for name, value in values)


def _notes(run: Run, progress: Progress) -> Iterator[str]:
    """Sentences that a reader of the files should know."""
    yield _WHICH
    if run.options.blur:
        yield _HIDDEN.format(run.options.blur)
    if not run.inputs.again:
        yield _LATEST
    if progress.shakes:
        yield _SHAKES


def _problems(run: Run, progress: Progress) -> Iterator[str]:
    """Sentences about problems: losses of the source, and what stopped the run."""
    inputs = run.inputs
    yield from filter(None, (*inputs.warnings, inputs.source.note, progress.source_problem))
    alone = progress.frames == 1 and progress.stop is None and "frames" not in run.options.read
    if alone and inputs.described in BACKGROUND:
        yield _ONE_PICTURE.format(inputs.described)
    annotated = 0
    if run.options.truth is not None:
        annotated = int(run.options.truth.frame.max(initial=0))
    interruption = f"stopped by {run.reporter.signal}"
    stop, cut = (
        interruption if isinstance(one, KeyboardInterrupt) else one
        for one in (progress.stop, progress.cut)
    )
    yield from lines(
        "problems.txt",
        stop=stop,
        cut=cut,
        last=progress.last,
        drawn=progress.drawn,
        annotated=annotated,
        last_detected=inputs.last_detected,
        video=rundir.VIDEO,
    )
    yield from progress.tracker.left_out.sentences()
    yield from progress.tracker.warnings
