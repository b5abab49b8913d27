"""``phdtrack batch``: many videos, shared out to processes, to the jobs of an array, or by Ray."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from phdtrack.cli import options as given
from phdtrack.cli.app import Misuse, parser
from phdtrack.cli.options import one_of, option, seconds
from phdtrack.cli.output import PACE, Output, counted, without_numbers
from phdtrack.detect.moving_regions import BACKGROUND, reported_kind
from phdtrack.errors import InputError, needed
from phdtrack.parallel import Failed, on_ray, outcomes
from phdtrack.report import write_run
from phdtrack.run.requests import RunRequest
from phdtrack.run.video_batch import DOCUMENT, ROWS, BatchPlan, BatchVideo, left_out

_SOURCES = "Videos, folders, patterns in quotes, files of detections; @FILE: a list of them."
_ENGINE = "Processes of this machine, or a Ray cluster, which has the same files."
_SEGMENT = (
    "Cut longer videos into segments of about this length, as 10m or 90s, and join their tracks."
    " Default: videos stay whole."
)
_OVERLAP = "Overlap of two segments, in which their identities are matched. Default: 20s."
_AGAIN = "Re-run videos whose options or files changed; restart incomplete ones."
Result = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Cutting:
    """How long videos are cut: seconds of a segment, 0 for whole videos, and of the overlap."""

    segment: Annotated[float, option("TIME", _SEGMENT, parser=seconds)] = 0.0
    overlap: Annotated[float, option("TIME", _OVERLAP, parser=seconds)] = 20.0


@dataclass(frozen=True, slots=True)
class Workers:
    """Processes or a cluster that run the videos."""

    jobs: Annotated[
        int, option("N", "Videos at once. Default: one per core, or what the cluster has.", min=0)
    ] = 0
    engine: Annotated[
        str, option("local|ray", _ENGINE, callback=lambda value: one_of(value, "local", "ray"))
    ] = "local"
    address: Annotated[
        str, option("ADDRESS", "Of the Ray cluster: auto, HOST:PORT, ray://HOST:PORT, or local.")
    ] = "auto"

    def results(self, tasks: Sequence[BatchVideo]) -> Iterator[tuple[str, Any]]:
        """Name and result of each task, as they end."""
        if self.engine == "ray":
            work = on_ray(tasks, self.jobs, self.address)
        else:
            work = outcomes(tasks, self.jobs or os.cpu_count() or 1, apart=True)
        for number, result in work:
            yield tasks[number].name, result


def batch(
    context: typer.Context,
    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help=_SOURCES)],
    output: Output,
    cutting: Cutting,
    workers: Workers,
    out: Annotated[
        Path, option("DIR", "Directory for the runs, the tracks of all, and the summary.")
    ],
    shard: Annotated[
        str, option("I/N", "Only the I-th of N shares of the videos, for job arrays; I from 1.")
    ] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help=_AGAIN)] = False,
) -> None:
    """Track many videos: phdtrack batch SOURCE... --out DIR [-- OPTIONS of phdtrack track].

    What follows -- goes to the run of each video; {} in it stands for the video's name. The same
    command again does what is missing, also after Ctrl-C. A video that fails is named in the
    summary, the others go on, and the exit status is 1.

    DIR/runs/NAME is the run of a video, DIR/tracks the Parquet files with the tracks of all,
    DIR/batch.json the summary.
    """
    needed("pyarrow.parquet")
    share = _share(shard)
    words = tuple(context.args)
    plan = BatchPlan(
        track_request(words), words, out, cutting.segment, cutting.overlap, anew=overwrite
    )
    work = Work.of(plan.videos(sources), share, None if overwrite else out)
    output.warn(filter(None, map(left_out, sources)))
    before = work.complete_videos
    began = time.perf_counter()
    file = out / DOCUMENT
    if shard:
        file = out / f"batch-{share[0]}-of-{share[1]}.json"
    try:
        for tasks in filter(None, work.left()):
            _follow(output, work.results, tasks, workers)
    finally:
        rows = [_summary(video, work.results) for video in work.videos]
        failed = [one["video"] for one in rows if one["state"] == "failed"]
        document: dict[str, object] = {
            "complete": not failed and work.complete,
            "reused": before,
            "failed": failed,
            "shard": shard,
            "seconds": time.perf_counter() - began,
            "videos": rows,
        }
        write_run(file, document)
    done = sum(one["state"] == "done" for one in rows)
    wait = len(rows) - done - len(failed)
    waiting = f", {wait} wait for segments of other shards" if wait else ""
    output.say(
        f"{counted(len(rows), 'video')}: {done - before} now, {before} before, {len(failed)}"
        f" failed{waiting}.",
        f"  {out / ROWS}  tracks of all",
        f"  {file}  the summary",
    )
    if any(one.get("doubtful_boxes") for one in rows):
        output.say(reported_kind(BACKGROUND[0]))
    output.document(document)
    if failed:
        raise typer.Exit(1)


@dataclass(slots=True)
class Work:
    """The work of a share of a batch.

    Attributes
    ----------
    videos : of which this share has a task.
    tasks : of this share: videos or segments.
    results : by name, of this call and of earlier ones.
    """

    videos: list[BatchVideo]
    tasks: list[BatchVideo]
    results: dict[str, Result]

    @classmethod
    def of(cls, videos: Sequence[BatchVideo], share: tuple[int, int], out: Path | None) -> Work:
        """The work of the I-th of N shares; ``out`` as in `_kept_results`."""
        number, shares = share
        every = [task for video in videos for task in video.parts or (video,)]
        tasks = every[number - 1 :: shares]
        own = {task.name for task in tasks}
        mine = [one for one in videos if own & {task.name for task in one.parts or (one,)}]
        return cls(mine, tasks, _kept_results(mine, out))

    @property
    def complete_videos(self) -> int:
        """The number of videos with a result."""
        return sum(video.name in self.results for video in self.videos)

    @property
    def complete(self) -> bool:
        """True if all tasks have a result, or are joined already."""
        return {task.name for task in self.tasks} <= self.results.keys() | self._joined

    @property
    def _joined(self) -> set[str]:
        """The segments of videos that have a result."""
        return {
            part.name for video in self.videos if video.name in self.results for part in video.parts
        }

    def left(self) -> Iterator[list[BatchVideo]]:
        """Tasks without a result, then videos whose segments are complete; others may have done the
        last ones.
        """
        done = self.results.keys() | self._joined
        yield [task for task in self.tasks if task.name not in done]
        yield [
            one
            for one in self.videos
            if one.parts and one.name not in self.results and all(part.result for part in one.parts)
        ]


def _kept_results(videos: Sequence[BatchVideo], out: Path | None) -> dict[str, Result]:
    """The results of earlier calls, by name. Raises `InputError` if other options decided one that
    is in ``out``, unless that is None.
    """
    runs = [run for video in videos for run in (video, *video.parts) if "result" in run.mark]
    others = [run.name for run in runs if run.mark.get("digest") != run.digest]
    if others and out:
        problem = (
            f"{counted(len(others), 'run')} there ({others[0]}, …) had other options, or the files"
            " have changed"
        )
        cure = "Say --overwrite to run these again, or choose another --out."
        raise InputError(problem, where=f"--out {out}", cure=cure)
    return {run.name: {"state": "done", **run.result} for run in runs if run.result}


def _summary(video: BatchVideo, results: Mapping[str, Result]) -> Result:
    """The row of a video in the summary; its error is null if there is none, so that queries find
    the column.
    """
    row = {"video": video.name, "source": video.source, "state": "missing", "error": None}
    row |= results.get(video.name, {})
    if not video.parts:
        return row
    for part in video.parts:
        error = results.get(part.name, {}).get("error")
        if error is not None:
            row |= {"state": "failed", "error": f"{part.name}: {error}"}
            break
    return row | {"segments": len(video.parts)}


def _follow(
    output: Output, results: dict[str, Result], tasks: Sequence[BatchVideo], workers: Workers
) -> None:
    """Run tasks and add their results, with a bar, or a line for each if there is no terminal.

    What several runs warn of is said once.
    """
    said = set[str]()
    total = len(results) + len(tasks)
    with output.progress("videos", total, PACE) as advance:
        advance(len(results))
        for name, result in workers.results(tasks):
            if isinstance(result, Failed):
                results[name] = {"state": "failed", "error": result.reason}
                output.warn([f"{len(results)} of {total}: {name} failed: {result.reason}"])
            else:
                results[name] = {"state": "done", **result}
                for sentence in result["warnings"]:
                    if without_numbers(sentence) not in said:
                        said.add(without_numbers(sentence))
                        output.warn([f"{name}: {sentence}"])
                if not sys.stderr.isatty():
                    frames = counted(result["frames"], "frame")
                    output.note(f"{len(results)} of {total}: {name}, {frames}")
            advance(len(results))


def _share(shard: str) -> tuple[int, int]:
    """The number of the share, and of how many."""
    match = re.fullmatch(r"([1-9]\d{0,8})/([1-9]\d{0,8})", shard or "1/1")
    if not match or int(match[1]) > int(match[2]):
        problem = f"expected a share as 2/8, from 1 to the number of shares, got {shard!r}"
        raise InputError(problem, where="--shard")
    return int(match[1]), int(match[2])


def track_request(words: Iterable[str]) -> RunRequest:
    """The request that options of `phdtrack track` stand for. Raises `InputError` for words that it
    would not understand.
    """
    requests = list[RunRequest]()

    def keep(request: RunRequest, output: Output, max_file_size: given.MaxFileSize = "") -> None:
        """Track each video of the batch with these options."""
        requests.append(request)

    try:
        parser(keep, "track")(list(words), prog_name="phdtrack track", standalone_mode=False)
    except Misuse as error:
        cure = "See phdtrack track --help."
        raise InputError(error.format_message(), where="after --", cure=cure) from None
    if not requests:
        # Their help has been printed.
        raise typer.Exit
    return requests[0]
