"""A run as a library: from a source to tracks and the files of a directory, without a command line.

    prepared = prepare(RunRequest(SourceRequest("street/scene.mp4")))
    directory = claim(Path("runs/street"), overwrite=False)
    result = prepared.run(directory)

`run` is given inputs, stages, directory and observers; `prepare` makes them from a `RunRequest`.
Progress and sentences go to the `Reporter` that is handed in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.run.directory import RunDirectory, claim
    from phdtrack.run.inputs import Inputs, open_inputs
    from phdtrack.run.loop import DetectedFrame, TrackedFrame, track_frame, track_frames
    from phdtrack.run.observers import Report, RunObserver
    from phdtrack.run.preparation import PreparedRun, prepare
    from phdtrack.run.reporter import Reporter
    from phdtrack.run.requests import (
        OutputRequest,
        RunRequest,
        SourceRequest,
        TrackingRequest,
    )
    from phdtrack.run.running import RunOptions
    from phdtrack.run.video import RunResult, run

_MODULES = {
    "directory": ("RunDirectory", "claim"),
    "inputs": ("Inputs", "open_inputs"),
    "loop": ("DetectedFrame", "TrackedFrame", "track_frame", "track_frames"),
    "observers": ("Report", "RunObserver"),
    "preparation": ("PreparedRun", "prepare"),
    "reporter": ("Reporter",),
    "requests": ("OutputRequest", "RunRequest", "SourceRequest", "TrackingRequest"),
    "running": ("RunOptions",),
    "video": ("RunResult", "run"),
}
# Type checkers know the names by their imports, and find one that does not exist.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(
        __name__,
        {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names},
    )

__all__ = [
    "DetectedFrame",
    "Inputs",
    "OutputRequest",
    "PreparedRun",
    "Report",
    "Reporter",
    "RunDirectory",
    "RunObserver",
    "RunOptions",
    "RunRequest",
    "RunResult",
    "SourceRequest",
    "TrackedFrame",
    "TrackingRequest",
    "claim",
    "open_inputs",
    "prepare",
    "run",
    "track_frame",
    "track_frames",
]
