"""Several states of one scene side by side, such as day and night: each with its own births and false alarms.

One is active: it is in use, and it learns. What comes is asked of all of them before it is learned, and the gains
(`evidence`) decide which one is active: another one where it explains what comes better by 0.2 nats a sample and by two
standard errors of both; a new one, which begins with a fifth of what the active one knows, where that one explains it worse
than it used to, by one nat and three standard errors, and no other explains it better. Two that explain each other's samples
as well as their own are one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phdtrack.scene.evidence import ERRORS, FEWEST, Evidence
from phdtrack.scene.humble import Humble, humble
from phdtrack.scene.part import Batch, Part

# Nats a sample by which another mode must be better; below which two are the same; that one must have lost.
BETTER, ALIKE, LOST = 0.2, 0.1, 1.0
# Standard errors by which a mode must have become worse than it was.
_SURE = 3.0
# Part of the memory for which a mode must have been active before it is compared.
_YOUNG = 1 / 8
# Samples that a mode must hold before it can be told whether another is the same.
_ENOUGH = 100


@dataclass(frozen=True, eq=False)
class Mode:
    """One state of the scene: its ``name``, what it knows of births, of false alarms and of detections of objects, and for
    how many seconds it was active (``clock``)."""

    name: str
    births: Part
    clutter: Part
    objects: Part
    clock: float = 0.0

    @cached_property
    def humble(self) -> Humble:
        """What it knows, as it is used."""
        return humble(self.births, self.clutter, self.objects)

    @property
    def used(self) -> Humble:
        """What of it is in use: births and false alarms that are trusted, and objects."""
        known = self.humble
        return Humble(
            known.births if self.births_used else None, known.clutter if self.clutter.trusted else None, known.objects
        )

    @property
    def births_used(self) -> bool:
        """Whether births are in use: they are trusted, and it is known where objects are."""
        return self.births.trusted and len(self.objects.density) > 0

    @property
    def evidence(self) -> Evidence:
        """For births and false alarms together."""
        return self.births.evidence.joined(self.clutter.evidence)

    @property
    def newest(self) -> Evidence:
        """The same of the last batch alone."""
        return self.births.newest.joined(self.clutter.newest)

    @property
    def lost(self) -> bool:
        """Whether it explains worse what comes than what came before."""
        now, usual = self.evidence, self.births.usual.joined(self.clutter.usual)
        sure = _SURE * math.hypot(now.error, usual.error)
        return now.count >= FEWEST and usual.mean - now.mean > max(LOST, sure)

    def young(self, memory: float) -> bool:
        """Whether it was not active for long enough to be compared; ``memory`` in seconds."""
        return self.clock < _YOUNG * memory

    @property
    def trusted(self) -> bool:
        """Whether anything of it is in use."""
        return self.births_used or self.clutter.trusted


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """What the last ``seconds`` taught: births, false alarms, detections of objects."""

    births: Batch
    clutter: Batch
    objects: Batch
    seconds: float


def asked(mode: Mode, lesson: Lesson, memory: float) -> Mode:
    """With the evidence of samples that it has not learned; ``memory`` in seconds."""
    entering = mode.humble.entering
    births = mode.births if entering is None else mode.births.asked(lesson.births, memory, entering)
    return replace(mode, births=births, clutter=mode.clutter.asked(lesson.clutter, memory))


def taught(mode: Mode, lesson: Lesson, memory: float) -> Mode:
    """After learning them."""
    now = mode.clock + lesson.seconds
    births, clutter = mode.births.taught(lesson.births, now, memory), mode.clutter.taught(lesson.clutter, now, memory)
    return replace(mode, births=births, clutter=clutter, objects=mode.objects.taught(lesson.objects, now, memory), clock=now)


def judged(mode: Mode) -> Mode:
    """With each part in use or not, as the evidence says."""
    return replace(mode, births=mode.births.judged(), clutter=mode.clutter.judged())


def forked(mode: Mode, name: str) -> Mode:
    """A new mode that begins with some of what another one knows."""
    return Mode(name, mode.births.forked(), mode.clutter.forked(), mode.objects.forked())


def unlearned(mode: Mode, seconds: float) -> Mode:
    """Without the samples of its last ``seconds``, which were another mode's."""
    until = mode.clock - seconds

    def part(it: Part) -> Part:
        return replace(it, recent=it.recent.take(it.recent.time <= until), evidence=Evidence())

    return replace(mode, births=part(mode.births), clutter=part(mode.clutter), objects=part(mode.objects))


def best(evidence: Sequence[Evidence], active: int) -> int:
    """The mode that should be active, by the evidence for each."""
    own, chosen, most = evidence[active], active, 0.0
    for k, other in enumerate(evidence):
        ahead = other.mean - own.mean
        sure = ERRORS * math.hypot(own.error, other.error)
        if k != active and other.for_it and ahead > max(BETTER, sure, most):
            chosen, most = k, ahead
    return chosen


def alike(a: Mode, b: Mode) -> bool:
    """Whether the false alarms of each are explained as well by the other."""
    p, q = a.clutter, b.clutter
    if min(len(p.recent), len(q.recent)) < _ENOUGH or not (p.rate < 2 * q.rate < 4 * p.rate):
        return False
    return _lost(p, q) < ALIKE and _lost(q, p) < ALIKE


def _lost(p: Part, q: Part) -> float:
    """Nats by which p's samples are explained worse by q."""
    own, other = p.density.log(p.recent.samples), q.density.log(p.recent.samples)
    return float(np.average(own - other, weights=p.recent.weight))
