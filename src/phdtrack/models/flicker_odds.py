"""Detections where a scene flickers start fewer targets.

Where something flickers, a first detection is an object with odds below one (`scene.flicker`). As
with scores (`models.clutter.ScoredClutter`), they divide the density of false alarms: a detection
of low odds continues a target that is there, and hardly starts one. So whoever walks through a
crown of a tree keeps his track, and who enters there is found a little later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.models.clutter import ScoredClutter
from phdtrack.protocols import Clutter, Learning, Model
from phdtrack.scene.flicker import FlickerMap
from phdtrack.types import F8, Detections, Step


@dataclass(frozen=True, slots=True)
class FlickerOdds(Learning[Any]):
    """The flicker that was learned of a scene before, for all of its frames.

    Parameters
    ----------
    learned : where the scene flickers.
    scores : what scores say besides; None if they are not learned.
    """

    learned: FlickerMap
    scores: Learning[Any] | None = None

    def start(self) -> Any:
        """The state of what scores say."""
        return None if self.scores is None else self.scores.start()

    def model(self, state: Any, model: Model) -> Model:
        """The model with what scores have taught."""
        return model if self.scores is None else self.scores.model(state, model)

    def with_scores(self, state: Any, model: Model, detections: Detections) -> Model:
        """The model whose false alarms are weighed by the places of the detections."""
        if self.scores is not None:
            model = self.scores.with_scores(state, model, detections)
        return with_odds(model, self.learned.odds(to_cxcywh(detections.xyxy)))

    def advance(self, state: Any, step: Step) -> Any:
        """The state of what scores say, after a frame."""
        return None if self.scores is None else self.scores.advance(state, step)


def with_odds(model: Model, odds: F8) -> Model:
    """The model in which the detections of a frame are objects with these odds (N,), too; the same
    if all are 1.
    """
    if (odds == 1).all():
        return model
    clutter: Clutter = model.clutter
    if isinstance(clutter, ScoredClutter):
        return replace(model, clutter=replace(clutter, odds=clutter.odds * odds))
    return replace(model, clutter=ScoredClutter(clutter, odds, np.zeros(len(odds))))
