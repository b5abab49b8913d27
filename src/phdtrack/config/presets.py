"""Presets, and the one that holds if none is named.

The preset ``default`` is the defaults of the parts themselves. Each other preset is one complete
file in ``preset_files/``, as ``--config`` reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from phdtrack.files import read_toml

_FOLDER = Path(__file__).with_name("preset_files")
PRESETS = ("default", *sorted(path.stem for path in _FOLDER.glob("*.toml")))
# The preset that holds if none is named: by what is tracked, and by the filter, "" for all others.
USUAL: Mapping[str, Mapping[str, str]] = {
    "box": {"pmb": "default", "": "other-filters"},
    "box of a background detector": {
        "pmb": "background",
        "none": "other-filters",
        "": "background-other-filters",
    },
    "box of another built-in detector": {"pmb": "mot15", "": "other-filters"},
    "plane": {"pmb": "ground", "": "ground-other-filters"},
    "point": {"pmb": "points", "": "points-other-filters"},
}


def usual_preset(motion: str, filter_name: str, detector: str = "") -> str:
    """The preset that holds if none is named.

    Parameters
    ----------
    motion, filter_name : kinds of ``[motion]`` and ``[filter]``.
    detector : the package's own detector that makes the boxes; empty for boxes from a file, a
        network or a caller.
    """
    tracked = motion
    if motion == "box" and detector and ":" not in detector:
        from phdtrack.detect import BACKGROUND

        known = detector in BACKGROUND
        tracked = f"box of {'a background' if known else 'another built-in'} detector"
    usual = USUAL[tracked]
    return usual.get(filter_name, usual[""])


@cache
def preset_values(preset: str) -> Mapping[str, Mapping[str, Any]]:
    """The values of a preset by section, with their ``kind``."""
    if preset == "default":
        return {}
    return {
        section: {name: _typed(value) for name, value in values.items()}
        for section, values in read_toml(_FOLDER / f"{preset}.toml").items()
    }


def _typed(value: Any) -> Any:
    """A value with the types that settings have: TOML's arrays as tuples."""
    if isinstance(value, list):
        return tuple(map(_typed, value))
    return value
