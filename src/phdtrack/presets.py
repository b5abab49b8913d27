"""The papers' parameters, and the defaults, as overlays on the records' own defaults.

``default``: what `phdtrack track` uses: M09's model with a lower p_D, a steadier size and less clutter, as today's detectors
have, births and clutter around the detections, states joined that no sensor could tell apart, and half of M07's particles,
which costs less than half a hundredth of any score and takes a quarter off the tracker's time (`reproduce.particles`).
``m07``: Maggio et al. 2007: likelihood scaled by the detection, births and clutter around the detections, K-means.
``m09``: Maggio and Cavallaro 2009: M07's numbers (M09 prints none of its own) with the likelihood scaled by the particle, no
floor, births and clutter uniform over the image, and extraction by a Gaussian mixture at 0.5.
``fv``: M09's fixed variances: constant noises in pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_PAPER: Mapping[str, Mapping[str, Any]] = {
    "motion": {"acceleration": 0.03, "resize": 0.1, "survival": 0.99},
    "sensor": {"detection": 0.95, "spread": 0.15},
    "birth": {"rate": 0.01, "most": 1000},
    "clutter": {"rate": 1.0},
    "filter": {"per_target": 1500},
    # No paper joins states that overlap.
    "extract": {"lightest": 0.6, "overlap": 1.0},
}
_M09: Mapping[str, Mapping[str, Any]] = {
    **_PAPER,
    "sensor": {**_PAPER["sensor"], "floor": 0.0, "scaling": "particle"},
    "extract": {"kind": "mixture", "lightest": 0.5, "overlap": 1.0},
}

PRESETS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "default": {
        "motion": {"acceleration": 0.03, "resize": 0.07, "survival": 0.99},
        "sensor": {"detection": 0.9, "spread": 0.15, "scaling": "particle"},
        "birth": {"rate": 0.01, "most": 500, "volume": "local"},
        "clutter": {"rate": 0.3, "volume": "local"},
        "filter": {"per_target": 750},
    },
    "m07": {
        **_PAPER,
        "sensor": {**_PAPER["sensor"], "scaling": "detection"},
        "birth": {**_PAPER["birth"], "volume": "local"},
        "clutter": {**_PAPER["clutter"], "volume": "local"},
        "extract": {**_PAPER["extract"], "kind": "kmeans"},
    },
    "m09": _M09,
    "fv": {
        **_M09,
        "motion": {"acceleration": 1.5**0.5, "resize": 2.0, "survival": 0.99, "scaled": False},
        "sensor": {"detection": 0.95, "scaling": "fixed"},
    },
}
