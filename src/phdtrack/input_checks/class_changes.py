"""Objects whose class changes from frame to frame: classes are tracked apart, and the track breaks.

An object changes its class if its box continues one of another class in the frame before, and if
neither frame has a box of both classes there: those are two objects, as a bicycle and its rider.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from phdtrack.arrays import iou, iou_of_pairs
from phdtrack.types import F8, I8, Bool

# Overlap (IoU) of an object with itself in the next frame, and of two boxes of the same object.
_SAME = 0.7
# Changes between two classes that are too many, and their share of the links of the rarer one.
_CHANGES = 15
_SHARE = 0.02
# Pairs of classes that are counted.
_MAX_PAIRS = 200

Pair = tuple[int, int]
"""Two classes, the lower one first."""


@dataclass(frozen=True, slots=True)
class ClassLinks:
    """Counts of links between objects in successive frames.

    Attributes
    ----------
    changes : of those between two classes.
    kept : by class, of those between two boxes of it.
    """

    changes: dict[Pair, int] = field(default_factory=dict)
    kept: dict[int, int] = field(default_factory=dict)

    def often(self, pair: Pair) -> bool:
        """True if objects change between these classes again and again."""
        changes = self.changes.get(pair, 0)
        kept = min(self.kept.get(label, 0) for label in pair)
        return changes >= _CHANGES and changes >= _SHARE * (changes + kept)


def with_links(
    links: ClassLinks, before: tuple[F8, I8], now: tuple[F8, I8], link: I8
) -> tuple[ClassLinks, tuple[Pair, ...]]:
    """The counts after a frame, and between which classes objects changed in it.

    Parameters
    ----------
    links : before the frame.
    before, now : (n, 4) boxes of the frame before and (n,) their classes, and the (m,) of this one.
    link : (m,) the box before that each continues, −1 for none.
    """
    after = np.flatnonzero(link >= 0)
    origin = link[after]
    same = before[1][origin] == now[1][after]
    kept = dict(links.kept)
    labels, counts = np.unique(now[1][after[same]], return_counts=True)
    for label, count in zip(labels.tolist(), counts.tolist(), strict=True):
        kept[label] = kept.get(label, 0) + count
    changes = dict(links.changes)
    pairs = tuple(_changed(before, now, origin[~same], after[~same]))
    for pair in pairs:
        if pair in changes or len(changes) < _MAX_PAIRS:
            changes[pair] = changes.get(pair, 0) + 1
    return ClassLinks(changes, kept), pairs


def _changed(before: tuple[F8, I8], now: tuple[F8, I8], origin: I8, after: I8) -> Iterator[Pair]:
    """The classes of each object that changed them; ``origin`` and ``after`` (k,) are its boxes."""
    if not len(after):
        return
    old = before[1][origin]
    new = now[1][after]
    good = iou_of_pairs(before[0][origin], now[0][after]) >= _SAME
    good &= ~_beside(before, before[0][origin], new)
    good &= ~_beside(now, now[0][after], old)
    for pair in zip(old[good].tolist(), new[good].tolist(), strict=True):
        yield min(pair), max(pair)


def _beside(frame: tuple[F8, I8], boxes: F8, labels: I8) -> Bool:
    """(k,) whether the frame has a box of each class (k,) in the place of each of the boxes."""
    overlap = iou(boxes, frame[0]) >= _SAME
    both = overlap & (frame[1] == labels[:, None])
    return np.asarray(both.any(axis=1))


def class_warning(links: ClassLinks, pair: Pair, groups: Iterable[tuple[int, ...]]) -> str:
    """A sentence on objects that change between these classes.

    Parameters
    ----------
    links, pair : the counts, and the classes.
    groups : classes that are tracked together already.
    """
    members = set(pair)
    for group in groups:
        if members & set(group):
            members |= set(group)
    return (
        f"objects changed between the classes {pair[0]} and {pair[1]} from one frame to the next,"
        f" {links.changes[pair]} times so far, and their tracks break there: track these classes"
        f' together, classes={{"together": [{sorted(members)}]}}'
    )
