"""The conventions of files of boxes: those that the user names, and sentences about guesses.

Readers decide by the content of a file what it leaves open, and report it in one sentence. What a
`Conventions` names goes before such evidence.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

from phdtrack.errors import InputError
from phdtrack.files import AnyPath

FORMATS = ("mot15", "mot17", "uavdt", "visdrone", "kitti", "coco", "cvat", "detrac")
UNITS = ("pixels", "shares")
BOXES = ("ltwh", "ltrb")
# The sequence that stands for all images of a COCO file.
ALL = "all"

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Conventions:
    """How a file is to be read; what is empty is decided by its content. Raises `InputError` for a
    name that is not known.

    Attributes
    ----------
    format : one of `FORMATS`.
    first_frame : the number that the file gives the first frame; None: as usual in its format.
    units : ``pixels``, or ``shares`` of the frame's size.
    box : what four numbers of a box mean: ``ltwh`` (left, top, width, height) or ``ltrb`` (left,
        top, right, bottom).
    sequence : the video to read of a COCO file with several; ``all`` reads them as one.
    frame_size : width and height in pixels, for shares; (0, 0): that of ``seqinfo.ini``.
    """

    format: str = ""
    first_frame: int | None = None
    units: str = ""
    box: str = ""
    sequence: str = ""
    frame_size: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        choices = (("format", FORMATS), ("units", UNITS), ("box", BOXES))
        for name, known in choices:
            value = getattr(self, name)
            if value and value not in known:
                raise InputError(f"expected {', '.join(known)}, got {value!r}", where=f"--{name}")

    def starting_at(self, first_frame: int | None) -> Conventions:
        """The same with this ``first_frame``, unless it is None."""
        if first_frame is None:
            return self
        return replace(self, first_frame=first_frame)


BY_EVIDENCE = Conventions()


def report(notices: list[str] | None, path: AnyPath, sentence: str) -> None:
    """Add a sentence about a file to a list, or log it as a warning.

    Parameters
    ----------
    notices : the list; None: the sentence is logged.
    path : the file.
    sentence : what was guessed, or looks wrong.
    """
    if notices is None:
        _LOG.warning("%s: %s", path, sentence)
    else:
        notices.append(f"{path}: {sentence}")
