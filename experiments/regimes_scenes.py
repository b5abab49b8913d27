"""Regimes drawn at random for the experiment on regimes, and where its harness is.

Imports nothing of phdtrack: the environment of the peers has neither its dependencies nor itself.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

SEED = 90117
REGIMES = 200
# Scenes of each random regime.
SCENES = 2
SCORES = ("none", "constant", "informative", "low", "random")
# The grid's frame, and its larger one for fast objects.
FRAME = (1920, 1080)
LARGE_FRAME = (3840, 2160)
FAST = 250.0
# More objects than this are simulated for fewer frames.
MANY = 30
QUANTITIES = ("fps", "speed", "size", "every", "p_d", "clutter", "noise", "n", "parked", "turn")
PEERS = ("sort", "bytetrack", "ocsort")
CSV = Path(__file__).with_name("regimes_peers.csv")
# Parameters of a scene, by their names in the harness.
Parameters = Mapping[str, Any]


def harness(folder: Path) -> ModuleType:
    """The module regimes.py in ``folder``: scenes, the grid, scores, and runs of trackers."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return importlib.import_module("regimes")


def random_regimes(seed: int, number: int) -> list[dict[str, Any]]:
    """The parameters of ``number`` regimes: the kind of scores and two or three other quantities
    are drawn, the others are those of the harness.

    The first regimes of a seed are the same for every number.
    """
    rng = np.random.default_rng(seed)
    return [_regime(rng) for _ in range(number)]


def _regime(rng: np.random.Generator) -> dict[str, Any]:
    changed = set(rng.choice(QUANTITIES, size=rng.integers(2, 4), replace=False).tolist())
    drawn = _quantities(rng)
    regime: dict[str, Any] = {"score": drawn.pop("score")}
    share = drawn.pop("parked")
    regime.update((name, value) for name, value in drawn.items() if name in changed)
    n = regime.get("n", 6)
    if "parked" in changed:
        regime["parked"] = max(1, round(share * n))
    if regime.get("speed", 0.0) > FAST:
        regime["width"] = LARGE_FRAME[0]
        regime["height"] = LARGE_FRAME[1]
    regime["frames"] = _frames(regime.get("fps", 25), regime.get("every", 1), n)
    return regime


def _quantities(rng: np.random.Generator) -> dict[str, Any]:
    """A value for every quantity, rounded as the page shows it; ``parked`` is a share."""

    def between(low: float, high: float, digits: int = 0) -> float:
        return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), digits)

    width = between(4, 400)
    height = min(round(width * between(0.5, 2.7, 2)), 600)
    return {
        "score": str(rng.choice(SCORES)),
        "fps": int(between(1, 60)),
        "speed": between(10, 2500),
        "size": (int(width), int(height)),
        "every": int(between(2, 30)),
        "p_d": round(float(rng.uniform(0.3, 1)), 2),
        "clutter": between(0.1, 60, 1),
        "noise": between(0.003, 0.25, 3),
        "n": int(between(1, 100)),
        "turn": between(0.2, 3, 1),
        "parked": float(rng.uniform()),
    }


def _frames(fps: int, every: int, n: int) -> int:
    """The number of frames, as in the grid."""
    if n > MANY:
        return 120
    if every > 1:
        return 400
    return min(400, max(60, 20 * fps))


def described(regime: Parameters) -> str:
    """The parameters in one line, those of the harness left out."""
    width, height = regime.get("size", (0, 0))
    parts = {
        "score": f"scores {regime['score']}",
        "fps": f"{regime.get('fps')} fps",
        "every": f"detector every {regime.get('every')} frames",
        "speed": f"{regime.get('speed', 0.0):.0f} px/s",
        "size": f"boxes {width}x{height}",
        "p_d": f"p_D {regime.get('p_d')}",
        "clutter": f"false boxes {regime.get('clutter')} a frame",
        "noise": f"noise {regime.get('noise')}",
        "n": f"objects {regime.get('n')}",
        "parked": f"parked {regime.get('parked')}",
        "turn": f"turn {regime.get('turn')} rad/√s",
    }
    return "; ".join(text for name, text in parts.items() if name in regime)
