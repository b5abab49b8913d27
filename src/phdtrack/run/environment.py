"""The versions of everything that a run's numbers depend on."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from pathlib import Path

import phdtrack
from phdtrack import __version__

# They overwrite each other's files; all that are installed are named.
_OPENCV = (
    "opencv-contrib-python",
    "opencv-contrib-python-headless",
    "opencv-python",
    "opencv-python-headless",
)
_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    *_OPENCV,
    "av",
    "typer",
    "rich",
    "pydantic",
    "matplotlib",
    "pyarrow",
)
# Packages that decode pictures or find objects in them.
_DETECTING = (
    "av",
    "numba",
    "numpy",
    "onnxruntime",
    *_OPENCV,
    "scipy",
)
# Packages of phdtrack on which no result depends.
_NO_RESULT = ("cli", "label", "live", "report", "groups")
HOME = Path(phdtrack.__file__).parent
"""The folder of phdtrack's sources."""


def versions() -> tuple[tuple[str, str], ...]:
    """Names and versions of phdtrack, Python, the system, and the installed packages it uses."""
    found = [
        ("phdtrack", __version__),
        ("python", platform.python_version()),
        ("system", platform.platform()),
    ]
    return (*found, *_installed(_PACKAGES))


def detecting_packages() -> dict[str, str]:
    """Names and versions of the installed packages that decode pictures or detect objects."""
    return dict(_installed(_DETECTING))


@lru_cache(maxsize=1)
def sources_digest(home: Path) -> str:
    """The digest of phdtrack's sources in a folder, as far as results depend on them."""
    return files_digest(
        file
        for file in sorted(home.rglob("*.py"))
        if file.relative_to(home).parts[0] not in _NO_RESULT
    )


def files_digest(files: Iterable[Path]) -> str:
    """32 hexadecimal digits for files by their names and contents."""
    total = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            total.update(
                os.fsencode(file.name) + b"\0" + hashlib.file_digest(content, "sha256").digest()
            )
    return total.hexdigest()[:32]


def _installed(names: Iterable[str]) -> list[tuple[str, str]]:
    """Names and versions of those packages that are installed."""
    found = list[tuple[str, str]]()
    for name in names:
        with suppress(metadata.PackageNotFoundError):
            found.append((name, metadata.version(name)))
    return found
