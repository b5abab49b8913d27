"""Compiles the kernels of a run before there is one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from phdtrack.config import build_classes
from phdtrack.run import directory as rundir
from phdtrack.run.choices import chosen_settings
from phdtrack.run.preparation import prepare
from phdtrack.run.reporter import SILENT
from phdtrack.run.requests import DEFAULT_DETECTOR, RunRequest, SourceRequest, TrackingRequest
from phdtrack.simulate import Rendered, make_scene
from phdtrack.tracker import Tracker
from phdtrack.types import SequenceInfo
from phdtrack.video import VideoWriter

_INFO = SequenceInfo(1920, 1080, 25.0, 0, "warm-up")
# The scene, and its frames: enough for tracks, and for a second pass that knows where it flickers.
_SCENE = "street"
_FRAMES = 60


def warming_steps(tracking: TrackingRequest) -> Sequence[tuple[str, Callable[[], None]]]:
    """The work for these settings in steps, each with its title: tracking of detections and of
    moving regions, and a short video from its pictures to the report.

    Raises `InputError` for settings that cannot be used. A later step raises it if they are not for
    moving regions, or a package is missing.
    """
    of_detections = _tracker(tracking, "")
    return (
        ("tracking of detections", of_detections.warm_up),
        ("tracking of moving regions", lambda: _tracker(tracking, DEFAULT_DETECTOR).warm_up()),
        ("a short video, from its pictures to the report", lambda: _track_video(tracking)),
    )


def _tracker(tracking: TrackingRequest, detector: str) -> Tracker:
    """The tracker for boxes of the detector; empty: of a file."""
    settings = chosen_settings(tracking, detector=detector)
    stages = build_classes(settings, _INFO, moving=True)
    return Tracker(stages=stages, fps=_INFO.fps, seed=tracking.seed)


def _track_video(tracking: TrackingRequest) -> None:
    """Track a rendered scene into a directory that is removed afterwards."""
    scene = make_scene(_SCENE, 0, frames=_FRAMES)
    info = scene.info
    with TemporaryDirectory(prefix="phdtrack-warm-up-") as folder:
        video = Path(folder) / "scene.mp4"
        with VideoWriter(video, info.width, info.height, info.fps) as writer:
            for frame in Rendered(scene, np.random.default_rng(0)):
                writer.write(frame.image)
        request = RunRequest(SourceRequest(str(video)), tracking, checkpoint_every=0.0)
        prepared = prepare(request)
        result = prepared.run(rundir.claim(Path(folder) / "run", True), SILENT)
        if result.stop is not None:
            raise result.stop
