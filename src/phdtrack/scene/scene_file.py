"""A learned scene as one file: ``scene.json``.

    {"format": 1, "width": 768, "height": 576, "rate": 25, "source": "…",
     "births": {"rate": s̄, "samples": n, "low": […], "high": […], "uniform": α_u,
                "weight": […], "mean": [[…] per Gaussian], "covariance": [[[…]] per Gaussian]},
     "clutter": the same with r̄ and four components, "followed": {"share": λ, "objects": the same},
     "notes": {…}}

Rates are births per time unit (``rate`` time units are a second), and false alarms or detections of
objects per frame. Every part may be missing.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import load, read_json, write_text
from phdtrack.scene.mixture import SceneDensity

FORMAT = 1


@dataclass(frozen=True, slots=True, eq=False)
class LearnedDensity:
    """A ``density`` with its ``rate``, s̄ (births per time unit), r̄ (false alarms per frame) or
    detections of objects per frame, and the number of ``samples`` it was learned from."""

    rate: float
    density: SceneDensity
    samples: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class TrackedObjects:
    """The ``share`` of false alarms that become tracks, and the density of ``objects``.

    A share of 0 means that nobody checked the detections of the scene: then no track is withheld.
    """

    share: float
    objects: LearnedDensity


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The densities that were learned from a scene.

    Attributes
    ----------
    width, height : of the video in pixels.
    rate : time units per second of the births.
    source : the video or the detections that it was learned from.
    births, clutter : the learned densities; None if there were too few samples.
    notes : other figures by name, such as held-out log-likelihoods.
    followed : false alarms and objects that become tracks; None if too few detections were checked.
    """

    width: int
    height: int
    rate: float
    source: str
    births: LearnedDensity | None = None
    clutter: LearnedDensity | None = None
    notes: Mapping[str, float | int | str] = field(default_factory=dict)
    followed: TrackedObjects | None = None


def write_scene(path: Path, scene: Scene) -> None:
    """Write a scene, completely or not at all.

    Parameters
    ----------
    path : the file; an existing one is replaced.
    scene : what is written.
    """
    document = {
        "format": FORMAT,
        **{name: getattr(scene, name) for name in ("width", "height", "rate", "source")},
        "births": _plain(scene.births),
        "clutter": _plain(scene.clutter),
        "followed": None,
        "notes": dict(scene.notes),
    }
    if scene.followed:
        objects = _plain(scene.followed.objects)
        document["followed"] = {"share": scene.followed.share, "objects": objects}
    write_text(path, json.dumps(document, indent=1) + "\n")


def read_scene(path: Path) -> Scene:
    """Read a scene. Raises `InputError` if the file is missing or is not a learned scene.

    Parameters
    ----------
    path : what `write_scene` or ``phdtrack learn`` wrote.

    Returns
    -------
    The scene.
    """
    document = read_json(path, load(path))
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        got = type(document).__name__
        if isinstance(document, dict):
            got = reprlib.repr(document.get("format"))
        raise InputError(
            f"expected a learned scene of format {FORMAT}, got {got}",
            where=path,
            cure="Learn it again",
        )
    try:
        return Scene(
            int(document["width"]),
            int(document["height"]),
            float(document["rate"]),
            str(document["source"]),
            _learned(document["births"], 6),
            _learned(document["clutter"], 4),
            dict(document["notes"]),
            _followed(document.get("followed")),
        )
    except (InputError, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{type(error).__name__} {error}"
        if isinstance(error, InputError):
            reason = str(error)
        raise InputError(
            f"not a learned scene: {reason}", where=path, cure="Learn it again"
        ) from None


def _plain(learned: LearnedDensity | None) -> dict[str, Any] | None:
    """A density in the types of JSON."""
    if learned is None:
        return None
    p = learned.density
    arrays = {
        "low": p.low,
        "high": p.high,
        "weight": p.weight,
        "mean": p.mean.T,
        "covariance": p.covariance,
    }
    plain = {name: array.tolist() for name, array in arrays.items()}
    return {"rate": learned.rate, "samples": learned.samples, "uniform": p.uniform} | plain


def _learned(document: Any, dim: int) -> LearnedDensity | None:
    """The density of ``dim`` components in JSON; None for None."""
    if document is None:
        return None
    low, high, weight = (np.array(document[name], np.float64) for name in ("low", "high", "weight"))
    mean = np.array(document["mean"], np.float64).reshape(-1, len(low)).T
    cov = np.array(document["covariance"], np.float64).reshape(-1, len(low), len(low))
    rate = float(document["rate"])
    if not 0 <= rate < np.inf or len(low) != dim:
        raise InputError(
            f"expected a rate from 0 and {dim} components, got {rate:g} and {len(low)}"
        )
    density = SceneDensity(
        low, high, float(document["uniform"]), weight, np.ascontiguousarray(mean), cov
    )
    return LearnedDensity(rate, density, int(document["samples"]))


def _followed(document: Any) -> TrackedObjects | None:
    """The part ``followed`` in JSON; None without it."""
    objects = None
    if document is not None:
        objects = _learned(document["objects"], 4)
    if objects is None:
        return None
    share = float(document["share"])
    if not 0 <= share <= 1:
        raise InputError(f"expected a share from 0 to 1, got {share:g}")
    return TrackedObjects(share, objects)
