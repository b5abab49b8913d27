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
from phdtrack.kernels.appearance import UNKNOWN, Law, Looks, described, plain
from phdtrack.kernels.appearance_lessons import Followed, Lessons, taught
from phdtrack.types import F4, F8, I8, Detections

# Seconds after which the memory of how a target looked some time ago is renewed.
SPANS = (0.5, 2.0, 8.0)
# Seconds between two lessons of one target, the part of a box that must be free for one, and
# lessons that are remembered.
PAUSE = 0.2
LEAST_FREE = 0.5
REMEMBERED = 3000.0
# Lessons that are worth one: those of one target are not independent.
ALIKE = 5.0
# Descriptors that the mean of the stream is made of, at most.
MEAN_OF = 3000.0
# The least deviation of similarity, and for how many lessons the usual one counts.
LEAST_DEVIATION = 0.03
USUAL_DEVIATION = 0.15
USUAL_FOR = 5.0
# What evidence of pictures counts for where motion leaves doubt: what hides parts of objects makes
# them worse there than where the lessons come from.
TRUST = 0.5
# Seconds for which errors of descriptors usually last; lessons of single descriptors for which the
# usual values count, and the usual signal.
USUAL_INDEPENDENT = 0.5
PRIOR_SINGLE = 20.0
USUAL_SIGNAL = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceSeen:
    """The lessons of a stream.

    Attributes
    ----------
    mean : (D,) mean of all descriptors; (0,) before any.      count : of how many it is.
    followed : the targets that lessons are taken from.
    lessons : what they have taught.
    """

    mean: F4 = field(default_factory=lambda: np.zeros(0, np.float32))
    count: float = 0.0
    followed: Followed = field(default_factory=lambda: nobody(0))
    lessons: Lessons = field(
        default_factory=lambda: Lessons(np.zeros(6), np.zeros(3), np.zeros(6), np.zeros(6))
    )


def nobody(size: int) -> Followed:
    """No target, of descriptors of length ``size``."""
    none = np.zeros(0)
    return Followed(
        np.zeros(0, np.int64),
        np.zeros((0, size), np.float32),
        none,
        none,
        none,
        np.zeros((0, len(SPANS), size), np.float32),
        np.zeros((0, len(SPANS))),
        np.zeros((0, len(SPANS))),
        np.zeros((0, 2, size), np.float32),
        np.zeros((0, 2)),
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
        unit, seen, mean, free, count = described(
            np.ascontiguousarray(raw, np.float32),
            np.ascontiguousarray(detections.xyxy),
            mean,
            MEAN_OF,
            count,
        )
        after = AppearanceSeen(mean, count, state.followed, state.lessons)
        return after, Looks(unit, seen, mean, free, self.law(state.lessons), time, self.memory)

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
        independent, signal, near_deviation = self._noise(lessons.single)
        number, x, xx, s, xs, ss = lessons.same.tolist()
        others, t, tt = lessons.other.tolist()
        within = self.reidentify_within or math.inf
        least = min(number, others)
        if least <= 0:
            return UNKNOWN._replace(within=within)
        spread = xx - x * x / number
        fading = min((xs - x * s / number) / (spread + 1.0), 0.0)
        same = (s - fading * x) / number
        rest = ss - 2 * (same * s + fading * xs) + number * same**2
        rest += fading * (2 * same * x + fading * xx)
        usual = USUAL_FOR * USUAL_DEVIATION**2
        variance = (max(rest, 0.0) + usual) / (number + USUAL_FOR)
        other = t / others
        other_variance = (max(tt - others * other**2, 0.0) + usual) / (others + USUAL_FOR)
        return Law(
            TRUST * self.worth((number, same, variance), (others, other, other_variance)),
            same,
            fading,
            max(math.sqrt(variance), LEAST_DEVIATION),
            other,
            max(math.sqrt(other_variance), LEAST_DEVIATION),
            independent,
            signal,
            near_deviation,
            *self._means(lessons.means, signal),
            within,
        )

    def worth(self, same: tuple[float, float, float], other: tuple[float, float, float]) -> float:
        """How much similarity is worth, from 0 to 1: the less, the nearer to its standard error the
        difference of the two means is (James and Stein), and the fewer lessons there were.

        Parameters
        ----------
        same, other : number of lessons, mean and variance of the similarity of one object, and of
            two.
        """
        number, mean, variance = same
        others, other_mean, other_variance = other
        difference = mean - other_mean
        if difference <= 0:
            return 0.0
        error = ALIKE * (variance / number + other_variance / others)
        least = min(number, others)
        certain = max(1 - error / difference**2, 0.0)
        return certain * least / (least + self.prior_lessons)

    def _means(self, means: F8, signal: float) -> tuple[float, float, float, float, float]:
        """`Law.means_weight` and what follows it."""
        number, s, ss, others, t, tt = means.tolist()
        least = min(number, others)
        if least <= 0:
            return 0.0, 1.0, 1.0, 0.0, 1.0
        same = s / number
        other = t / others
        usual = USUAL_FOR * USUAL_DEVIATION**2
        variance = (max(ss - number * same**2, 0.0) + usual) / (number + USUAL_FOR)
        other_variance = (max(tt - others * other**2, 0.0) + usual) / (others + USUAL_FOR)
        return (
            self.worth((number, same, variance), (others, other, other_variance)),
            same,
            max(math.sqrt(variance), LEAST_DEVIATION),
            other,
            max(math.sqrt(other_variance), LEAST_DEVIATION),
        )

    def _noise(self, single: F8) -> tuple[float, float, float]:
        """Seconds for which errors of descriptors last, and the part of a single descriptor's
        variance that is the object's own [APP (4)].
        """
        near, apart, alike, far, long_after, squares = single.tolist()
        signal = (long_after + PRIOR_SINGLE * USUAL_SIGNAL) / (far + PRIOR_SINGLE)
        signal = min(max(signal, 0.05), 0.95)
        if near <= 0:
            return USUAL_INDEPENDENT, signal, USUAL_DEVIATION
        rho = (alike / near - signal) / (1 - signal)
        rho = min(max(rho, 0.001), 0.98)
        seconds = -(apart / near) / math.log(rho)
        share = near / (near + PRIOR_SINGLE)
        seconds = math.exp(share * math.log(seconds) + (1 - share) * math.log(USUAL_INDEPENDENT))
        rest = max(squares - alike**2 / near, 0.0) + USUAL_FOR * USUAL_DEVIATION**2
        return seconds, signal, max(math.sqrt(rest / (near + USUAL_FOR)), LEAST_DEVIATION)

    def advance(self, state: AppearanceSeen, sure: I8, looks: Looks | None) -> AppearanceSeen:
        """Learn from a frame whose targets without doubt are ``sure`` (K, 2): label, and
        measurement or −1.
        """
        if looks is None:
            return state
        followed, lessons = taught(
            tuple(state.followed),
            tuple(state.lessons),
            sure,
            plain(looks),
            (SPANS, PAUSE, LEAST_FREE, REMEMBERED),
        )
        return AppearanceSeen(state.mean, state.count, followed, lessons)
