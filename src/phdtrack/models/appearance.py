"""Appearance as evidence: what the boxes of a stream look like, and what similarity is worth there
(docs/methods.md, Appearance).

Nothing is known before the stream has shown it. Lessons come from targets whose detections motion
alone leaves no doubt of: what such a target looks like now, and looked like some time ago, against
the others of the same frame. So a stream whose objects look alike teaches that similarity says
nothing, and one without descriptors is as before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.kernels.appearance import Law, Looks, plain
from phdtrack.kernels.appearance_law import law_of, looks_and_law
from phdtrack.kernels.appearance_lessons import (
    EARLY,
    FIRST_EARLY,
    FOLLOWED,
    SUMS,
    Followed,
    Lessons,
    lessons_of,
    taught,
)
from phdtrack.types import F4, F8, I8, Detections

# Seconds after which the memory of how a target looked some time ago is renewed.
SPANS = (0.5, 2.0, 8.0)
# Seconds between two lessons of one target, the part of a box that must be free for one, and
# lessons that are remembered.
PAUSE = 0.2
LEAST_FREE = 0.5
REMEMBERED = 3000.0
# Descriptors that the mean of the stream is made of, at most.
MEAN_OF = 3000.0


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceSeen:
    """The lessons of a stream.

    Attributes
    ----------
    mean : (D,) mean of all descriptors; (0,) before any.      count : of how many it is.
    followed : the targets that lessons are taken from.
    sums : what they have taught, see `lessons`.
    """

    mean: F4 = field(default_factory=lambda: np.zeros(0, np.float32))
    count: float = 0.0
    followed: Followed = field(default_factory=lambda: nobody(0))
    sums: F8 = field(default_factory=lambda: np.zeros(SUMS))

    @property
    def lessons(self) -> Lessons:
        """Sums by kind of lesson."""
        return lessons_of(self.sums)


def nobody(size: int) -> Followed:
    """No target, of descriptors of length ``size``."""
    return Followed(
        np.zeros(0, FOLLOWED),
        np.zeros((0, len(SPANS)), EARLY),
        np.zeros((0, FIRST_EARLY + len(SPANS), size), np.float32),
    )


@dataclass(frozen=True, slots=True)
class Appearance(Checked):
    """Settings of appearance as evidence.

    Parameters
    ----------
    memory : seconds after which what a target looked like counts for 37 %.
    prior_lessons : lessons for which it counts that appearance says nothing.
    reidentify_within : seconds after which no target takes its identity again; 0: as long as the
        odds allow.
    """

    memory: Positive = 3.0
    prior_lessons: NonNegative = 2.0
    reidentify_within: NonNegative = 0.0

    def start(self) -> AppearanceSeen:
        """Nothing seen."""
        return AppearanceSeen()

    def looks(
        self, state: AppearanceSeen, detections: Detections, time: float
    ) -> tuple[AppearanceSeen, Looks | None]:
        """The state with the descriptors of a frame in its mean, and what its detections look like;
        None before the first descriptors.
        """
        raw = detections.embeddings
        if raw is None or not raw.shape[1]:
            if not len(state.mean):
                return state, None
            raw = np.zeros((len(detections), len(state.mean)), np.float32)
        mean = state.mean
        count = state.count
        if len(mean) != raw.shape[1]:
            mean = np.zeros(raw.shape[1], np.float32)
            count = 0.0
            state = AppearanceSeen(followed=nobody(raw.shape[1]))
        found, law = looks_and_law(
            np.ascontiguousarray(raw, np.float32),
            np.ascontiguousarray(detections.xyxy),
            mean,
            count,
            MEAN_OF,
            state.sums,
            self._rules,
        )
        unit, seen, mean, free, count, beside = found
        after = AppearanceSeen(mean, count, state.followed, state.sums)
        return after, Looks(unit, seen, mean, free, Law(*law), time, self.memory, beside)

    def known(self, state: AppearanceSeen) -> Looks | None:
        """The law that the stream has taught so far, with no detections; None where it had no
        descriptors.
        """
        if not len(state.mean):
            return None
        none = np.zeros((0, len(state.mean)), np.float32)
        law = self.law(state.lessons)
        return Looks(none, none, state.mean, np.zeros(0), law, 0.0, self.memory)

    def law(self, lessons: Lessons) -> Law:
        """The meaning of similarity by the lessons so far [APP (3)]."""
        return Law(*law_of(np.concatenate(lessons), *self._rules))

    @property
    def _rules(self) -> tuple[float, float, float]:
        """The arguments of `law_of` besides the lessons."""
        # Each mean is of much the same descriptors as the next.
        kept = math.exp(-PAUSE / self.memory)
        alike = (1 + kept) / (1 - kept)
        return self.prior_lessons, self.reidentify_within or math.inf, alike

    def advance(self, state: AppearanceSeen, sure: I8, looks: Looks | None) -> AppearanceSeen:
        """Learn from a frame whose targets without doubt are ``sure`` (K, 2): label, and
        measurement or −1.
        """
        if looks is None:
            return state
        followed, sums = taught(
            tuple(state.followed),
            state.sums,
            sure,
            plain(looks),
            (SPANS, PAUSE, LEAST_FREE, REMEMBERED),
        )
        return AppearanceSeen(state.mean, state.count, Followed(*followed), sums)
