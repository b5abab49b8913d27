"""Detectors that report moving regions, and what users are told of them."""

from __future__ import annotations

# They report connected components of what differs from the background: one object, several, or a
# fragment of one.
BACKGROUND = ("change", "mean-background", "mog2")
MOVING_REGIONS = "moving regions, not recognised objects: counts are approximate"


def reported_kind(name: str) -> str:
    """A sentence about what the detector ``name`` reports, if that is not objects; else empty."""
    if name in BACKGROUND:
        return f"{MOVING_REGIONS.capitalize()}."
    return ""
