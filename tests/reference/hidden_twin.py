"""Which boxes hide which, as the definition reads."""

from __future__ import annotations


def covered_part(box, other):
    """Shared area over the box's own."""
    width = min(box[2], other[2]) - max(box[0], other[0])
    height = min(box[3], other[3]) - max(box[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    return float(width) * float(height) / (float(box[2] - box[0]) * float(box[3] - box[1]))


def hiding(xyxy, depth, others, other_depth):
    """{(box, other): part of the box} for the others that are nearer."""
    return {
        (i, j): part
        for i in range(len(xyxy))
        for j in range(len(others))
        if other_depth[j] < depth[i] and (part := covered_part(xyxy[i], others[j])) > 0
    }
