"""The scene as it is learned while tracking: `context.online` as a stage, and what it has learned as γ and κ."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from phdtrack.context import Scene
from phdtrack.context.clock import Clock
from phdtrack.context.modes import Mode
from phdtrack.context.online import Followed, Following, advance, begin, named, scene_of
from phdtrack.models.learned_scene import ContextBirth, ContextClutter
from phdtrack.models.standing import not_standing
from phdtrack.protocols import Model
from phdtrack.types import Detections, Step


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """What is known (``followed``), and what of it is in use: births and false alarms, None for those of the model."""

    followed: Followed
    birth: ContextBirth | None = None
    clutter: ContextClutter | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FollowScene:
    """Learning while tracking.

    Attributes
    ----------
    rule : how the scene is followed.     most : Jmax, see `ContextBirth`.
    scenes : what was learned before, one for each mode.     clock : which mode it is by time of day.
    """

    rule: Following
    most: int = 500
    scenes: tuple[Scene, ...] = ()
    clock: Clock = field(default_factory=Clock)

    def start(self) -> SceneState:
        """Before the first frame."""
        state = begin(self.rule, self.scenes)
        if self.clock.names:
            state = named(self.rule, state, self.clock.name(0.0))
        return self._in_use(state)

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
        before = state.followed
        followed = advance(self.rule, before, step)
        if followed.last is before.last:
            return SceneState(followed, state.birth, state.clutter)
        if self.clock.names:
            followed = named(self.rule, followed, self.clock.name(step.time))
        return self._in_use(followed)

    def mode(self, state: SceneState, name: str) -> SceneState:
        """With the mode of this name in use from now on; a new one, which knows nothing, where there is none."""
        return self._in_use(named(self.rule, state.followed, name))

    def scene(self, mode: Mode, source: str) -> Scene:
        """What a mode knows, to be written to a file."""
        return scene_of(self.rule, mode, source)

    def _in_use(self, followed: Followed) -> SceneState:
        births, clutter = followed.mode.births, followed.mode.clutter
        return SceneState(
            followed,
            ContextBirth(births.rate, births.density, most=self.most) if births.trusted else None,
            ContextClutter(clutter.rate, clutter.density) if clutter.trusted else None,
        )
