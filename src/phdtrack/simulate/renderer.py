"""The renderer: from a scene to a video with what makes change detection hard.

Painted from back to front: the backdrop, lights on it, shadows, then figures, obstacles and plants by the row of the foot;
at last the camera adds flicker and noise. Everything that can be drawn beforehand is; a frame costs a few milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from phdtrack.simulate.look import Look
from phdtrack.simulate.records import Scene
from phdtrack.types import F8, Frame, SequenceInfo


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """The video of a scene: a `Source` whose frames are painted when they are asked for, the same ones every time.

    Every iteration starts its random streams anew from ``seed``.
    """

    scene: Scene
    look: Look
    seed: int

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name."""
        return self.scene.info

    @property
    def plants(self) -> F8:
        """(P, 4) boxes of the waving plants at rest, pixels: where a change detector will report what is not there."""
        from phdtrack.simulate.paint.stage import plant_boxes

        return plant_boxes(self.scene, self.look.plants, self.seed)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, numbered from 1; ``image`` is (H, W, 3) BGR."""
        from phdtrack.simulate.paint.stage import Stage

        stage = Stage(self.scene, self.look, self.seed)
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, stage.paint(number))


def render(scene: Scene, rng: np.random.Generator, look: Look | None = None) -> Rendered:
    """The video of ``scene``. Draws one number from ``rng``, which decides everything that is random in it."""
    return Rendered(scene, look or Look(), int(rng.integers(2**62)))
