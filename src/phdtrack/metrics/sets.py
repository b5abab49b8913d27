"""Distances between the sets of boxes of a frame.

OSPA (Schuhmacher, Vo, Vo 2008) and GOSPA (Rahmathullah et al. 2017: not divided by the larger
number of boxes, with c^p/α for each surplus box) have the base distance 1 − IoU, c = 1, p = 1,
α = 2. They are averaged over all frames of the sequence; a frame that is empty on both sides counts
as 0.

SFDA (Kasturi et al. 2009) is the mean of FDA over the frames with a box on either side:

    FDA(k) = Σ_mapped IoU / ((N_G(k) + N_D(k)) / 2)
"""

from __future__ import annotations

from phdtrack.metrics.identity import largest_total
from phdtrack.metrics.matching import SequencePair


def set_distances(sequence: SequencePair) -> tuple[float, float, float]:
    """Sums over the frames of OSPA, of GOSPA and of FDA."""
    ospa = 0.0
    gospa = 0.0
    fda = 0.0
    for pair in sequence.pairs:
        n, m = pair.iou.shape
        # With distance 1 − IoU, the mapping with the largest overlap is the cheapest for all three.
        overlap = largest_total(pair.iou)
        distance = min(n, m) - overlap
        ospa += (distance + abs(n - m)) / max(n, m)
        gospa += distance + abs(n - m) / 2
        fda += 2 * overlap / (n + m)
    return ospa, gospa, fda
