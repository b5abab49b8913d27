"""The versions of everything that a run's numbers depend on."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib import metadata

from phdtrack import __version__

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "av",
    "typer",
    "rich",
    "pydantic",
    "matplotlib",
    "pyarrow",
)


def versions() -> tuple[tuple[str, str], ...]:
    """Names and versions of phdtrack, Python, the system, and the installed packages it uses."""
    found = [
        ("phdtrack", __version__),
        ("python", platform.python_version()),
        ("system", platform.platform()),
    ]
    for name in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found.append((name, metadata.version(name)))
    return tuple(found)
