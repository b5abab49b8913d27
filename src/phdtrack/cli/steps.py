"""The tracker as the run loop drives it: one frame's detections in, its step out, corrected tracks at the end."""

from __future__ import annotations

import numpy as np

from phdtrack import pipeline
from phdtrack.cli.ground import shown
from phdtrack.filters import NoFilter
from phdtrack.filters.intensities import Cardinalised
from phdtrack.models.followed_rates import RatesState
from phdtrack.models.followed_scene import SceneState
from phdtrack.protocols import AnyStages
from phdtrack.scene.rates import Rates
from phdtrack.types import F4, F8, STILL, Detections, Frame, ParticleBlocks, Particles, Step, Tracks


class Steps:
    """Holds the state between frames; everything else is `pipeline`'s."""

    def __init__(self, stages: AnyStages, rng: np.random.Generator) -> None:
        self._stages, self._rng = stages, rng
        self._state = pipeline.start(stages, rng)
        self._looks: dict[int, F4] = {}

    def look(self, frame: Frame, detections: Detections) -> None:
        """Remember what the detections of a frame look like, if anybody will ask."""
        looks = self._stages.smoother.describe(frame.image, detections.xyxy)
        if looks.shape[1]:
            self._looks[frame.number] = looks

    def advance(self, number: int, time: float, detections: Detections, warp: F8 = STILL) -> Step:
        """Take in the detections of frame ``number`` at ``time`` seconds; ``warp`` is how the camera has moved."""
        self._state, step = pipeline.advance(self._stages, self._state, detections, number, time, self._rng, warp)
        return step

    @property
    def learned(self) -> SceneState:
        """What was learned of the scene, of stages that learn it while tracking."""
        learned = self._state.learned
        scene: SceneState = learned.beside if isinstance(learned, RatesState) else learned
        return scene

    @property
    def rates(self) -> Rates:
        """The rates as they are estimated now, of stages that learn them while tracking."""
        known: RatesState = self._state.learned
        return known.learned.rates

    @property
    def intensity(self) -> object:
        """The filter's state after the last frame."""
        return self._state.intensity

    @property
    def particles(self) -> Particles | None:
        """The filter's particles after the last frame where the image shows them (`ground.shown`); None where there is no
        filter, one without particles, or no image."""
        intensity = self._state.intensity
        if isinstance(intensity, Cardinalised):
            intensity = intensity.intensity
        if isinstance(intensity, ParticleBlocks):
            intensity = intensity.particles()
        if isinstance(self._stages.filter, NoFilter) or not isinstance(intensity, Particles):
            return None
        return shown(intensity, self._stages.model.sensor)

    def flush(self) -> Tracks:
        """The online rows that the output delay held back."""
        return self._stages.associator.flush(self._state.association, self._stages.model)

    def finish(self) -> Tracks:
        """The corrected tracks of everything taken in so far."""
        return pipeline.finish(self._stages, self._state, self._looks)
