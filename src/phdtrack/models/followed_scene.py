"""The scene as it is learned while tracking: `context.online` as a stage, and what it has learned laid over γ and κ.

What is learned from is what a second run says of the same frames, a *witness* that knows nothing of what was learned. By the
run itself who is doubted once, as he stands where a false alarm came, is learned as false, and doubted more. So nothing that
is learned rests on itself, and a scene of which nothing is in use is tracked as without learning.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from phdtrack.models.learned_scene import laid_over
from phdtrack.models.standing import not_standing
from phdtrack.protocols import Birth, Clutter, Model
from phdtrack.scene import Followed, Scene
from phdtrack.scene.clock import Clock
from phdtrack.scene.modes import Mode
from phdtrack.scene.online import Following, Knowledge, advance, begin, named, scene_of
from phdtrack.types import Detections, Step


class Witness(Protocol):
    """A run beside, which knows nothing of what is learned."""

    def start(self) -> Any:
        """The state before the first frame."""

    def advance(self, state: Any, step: Step) -> tuple[Any, Step]:
        """The state after one frame, and what it makes of the detections in ``step``."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What is ``known``, the ``witness``'s state, and what is in use: births and false alarms, None for the model's own."""

    known: Knowledge
    witness: Any = None
    birth: Birth | None = None
    clutter: Clutter | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FollowScene:
    """Learning while tracking.

    Attributes
    ----------
    rule : how the scene is followed.     shipped : the model over which what is learned is laid.
    witness : what is learned from.     most : Jmax, see `ContextBirth`.
    scenes : what was learned before, one for each mode.     clock : which mode it is by time of day.
    """

    rule: Following
    shipped: Model
    witness: Witness
    most: int = 500
    scenes: tuple[Scene, ...] = ()
    clock: Clock = field(default_factory=Clock)

    def start(self) -> SceneState:
        """Before the first frame."""
        known = begin(self.rule, self.scenes)
        if self.clock.names:
            known = named(self.rule, known, self.clock.name(0.0))
        return self._in_use(known, self.witness.start())

    def model(self, state: SceneState, model: Model) -> Model:
        """The model with what was learned, where that is in use.

        Raises `InputError` where the camera moves: what is learned lies at pixels.
        """
        if len(model.warp):
            raise not_standing("learning where false alarms and entrances are")
        if state.birth is None and state.clutter is None:
            return model
        return replace(model, birth=state.birth or model.birth, clutter=state.clutter or model.clutter)

    def weighed(self, state: SceneState, model: Model, detections: Detections) -> Model:
        """The same: scores are not learned here."""
        return model

    def advance(self, state: SceneState, step: Step) -> SceneState:
        """Take in one frame."""
        witness, told = self.witness.advance(state.witness, step)
        known = advance(self.rule, state.known, told)
        if known.last is state.known.last:
            return SceneState(known, witness, state.birth, state.clutter)
        if self.clock.names:
            known = named(self.rule, known, self.clock.name(step.time))
        return self._in_use(known, witness)

    def mode(self, state: SceneState, name: str) -> SceneState:
        """With the mode of this name in use from now on; a new one, which knows nothing, where there is none."""
        return self._in_use(named(self.rule, state.known, name), state.witness)

    def scene(self, mode: Mode, source: str) -> Scene:
        """What a mode knows, to be written to a file."""
        return scene_of(self.rule, mode, source)

    def _in_use(self, known: Knowledge, witness: Any) -> SceneState:
        used = known.mode.used
        objects = None if used.objects is None else Followed(0.0, used.objects)
        laid = laid_over(self.shipped, used.births, used.clutter, objects, self.most)
        birth = None if used.births is None else laid.birth
        return SceneState(known, witness, birth, None if used.clutter is None else laid.clutter)
