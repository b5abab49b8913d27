"""What OpenCV 4 ships and 5 dropped: asked for when it is used, with the line that mends its absence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from phdtrack.errors import InputError

MEND = "python -m pip uninstall -y opencv-python opencv-contrib-python; python -m pip install --force-reinstall "
MEND += '"opencv-python-headless>=4.8,<5"'


def shipped(name: str) -> Any:
    """``cv2.<name>``; InputError with the pip line where this OpenCV has none."""
    found = getattr(cv2, name, None)
    if found is None:
        raise InputError(
            f"OpenCV {cv2.__version__} has no {name}, which this detector needs; OpenCV 4 has it",
            cure=f"Another package may have replaced it. Mend it by: {MEND}",
        )
    return found


def cascade_file(name: str) -> Path:
    """The path of a cascade that OpenCV ships, or of the user's own; InputError where there is none."""
    own = Path(name)
    if own.suffix == ".xml" and own.is_file():
        return own
    folder = Path(shipped("data").haarcascades)
    path = folder / f"haarcascade_{name}.xml"
    if not path.is_file():
        names = sorted(file.stem.removeprefix("haarcascade_") for file in folder.glob("haarcascade_*.xml"))
        known = f"Shipped are {', '.join(names)}." if names else f"This OpenCV ships none. Mend it by: {MEND}"
        raise InputError(
            f"there is no cascade {name!r}", where="cascade", cure=f"{known} An .xml file of your own works too."
        )
    return path
