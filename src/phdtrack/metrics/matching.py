"""Mappings between annotated and output boxes over a sequence. Scores differ in the mapping that they count on:

* `detection_mapping`: the largest total overlap among pairs at IoU ≥ threshold, each frame for itself. MODA, MODP.
* `tracking_mapping`: first as many pairs as possible of those that were mapped before, then the largest total overlap.
  N_MODA, MOTA, MOTP, switches, fragments, delays, false tracks.
* The mapping of `hota.py`: overlap weighted by how well the two identities agree over the sequence. HOTA.
* The mapping of `identity.py`: one for the sequence; identities are mapped, not boxes. IDF1.

"Mapped before" means: in the last frame that held boxes on both sides. A frame with an empty side neither breaks nor makes a
mapping, in agreement with TrackEval's CLEAR [M09 (22)–(25)].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.assignment import above, assign
from phdtrack.metrics.scene import FramePair, Scene
from phdtrack.types import F8, I8

# Larger than any total overlap that a frame can hold, so that a kept pair outweighs all new ones.
KEEP = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The K mapped pairs of a sequence, frames ascending.

    Attributes
    ----------
    position : (K,) index of the frame in `Scene.pairs`.
    truth, output : (K,) indices of the two identities.
    iou : (K,) overlap of the two boxes.
    """

    position: I8
    truth: I8
    output: I8
    iou: F8

    def per_frame(self, scene: Scene) -> I8:
        """(F,) number of mapped pairs in each of the scene's frames."""
        return np.bincount(self.position, minlength=len(scene.pairs)).astype(np.int64)

    def iou_per_frame(self, scene: Scene) -> F8:
        """(F,) sum of the overlaps in each of the scene's frames."""
        return np.bincount(self.position, self.iou, minlength=len(scene.pairs)).astype(np.float64)


Part = tuple[int, I8, I8, F8]


def match(scene: Scene, score: Callable[[FramePair], F8]) -> Matches:
    """The mapping with the largest total ``score(pair)`` (n, m) in every frame; pairs of score 0 stay unmapped."""
    return gather([_part(position, pair, score(pair)) for position, pair in enumerate(scene.pairs) if pair.iou.size])


def detection_mapping(scene: Scene, threshold: float) -> Matches:
    """The largest total overlap among pairs at IoU ≥ ``threshold``, each frame for itself."""
    return match(scene, lambda pair: above(pair.iou, threshold))


def tracking_mapping(scene: Scene, threshold: float) -> Matches:
    """As `detection_mapping`, but pairs mapped in the frame before stay mapped while their IoU is ≥ ``threshold``."""
    parts: list[Part] = []
    before = np.full(len(scene.truth_identity), -1)
    for position, pair in enumerate(scene.pairs):
        if not pair.iou.size:
            continue
        kept = before[pair.truth][:, None] == pair.output[None, :]
        overlap = above(pair.iou, threshold)
        part = _part(position, pair, overlap + KEEP * (kept & (overlap > 0)))
        before = np.full_like(before, -1)
        before[part[1]] = part[2]
        parts.append(part)
    return gather(parts)


def gather(parts: list[Part]) -> Matches:
    """The parts of single frames in one record."""
    none = np.zeros(0, np.int64)
    return Matches(
        np.repeat(np.array([p[0] for p in parts], np.int64), [len(p[1]) for p in parts]),
        np.concatenate([none, *(p[1] for p in parts)]),
        np.concatenate([none, *(p[2] for p in parts)]),
        np.concatenate([np.zeros(0), *(p[3] for p in parts)]),
    )


def _part(position: int, pair: FramePair, score: F8) -> Part:
    rows, columns = assign(score)
    return position, pair.truth[rows], pair.output[columns], pair.iou[rows, columns]
