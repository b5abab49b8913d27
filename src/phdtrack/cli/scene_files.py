"""Files of a simulated scene that are neither truth nor detections: its video, and what MOTChallenge says about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phdtrack.cli.output import progress
from phdtrack.cli.pipeline_threads import ahead
from phdtrack.simulate import Look, Scene, render
from phdtrack.types import SequenceInfo
from phdtrack.video import VideoWriter


def render_video(scene: Scene, rng: np.random.Generator, path: Path, look: Look | None = None) -> None:
    """The scene as an mp4 file; ``look`` None for the renderer's own."""
    info = scene.info
    with (
        VideoWriter(path, info.width, info.height, info.fps) as writer,
        progress("rendering", info.frames) as advance,
        ahead(render(scene, rng, look)) as frames,
    ):
        for frame in frames:
            writer.write(frame.image)
            advance(frame.number)


def seqinfo(info: SequenceInfo) -> str:
    """The text of seqinfo.ini."""
    about = {"name": info.name, "frameRate": f"{info.fps:g}", "seqLength": info.frames}
    size = {"imWidth": info.width, "imHeight": info.height}
    return "\n".join(["[Sequence]", *(f"{key}={value}" for key, value in (about | size).items()), ""])
