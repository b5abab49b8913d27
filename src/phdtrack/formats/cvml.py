"""CVML: the XML of CAVIAR's ground truth, in which the truth of PETS 2009 is written too.

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/> ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are no objects: they are passed
over. A document type or an entity is refused, because that is how a small file is made to expand without bound; CVML needs
neither.
"""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.rows import Origin, Rows, Source

_NUMBERED = {"frame": "number", "object": "id", "group": "id"}


def rows_of_cvml(source: Source) -> Rows:
    """The boxes of the objects in a CVML document.

    Raises
    ------
    InputError : the document is not well-formed CVML, or declares a document type.
    """
    path = source.path
    reader = _Reader(path)
    try:
        reader.parser.Parse(source.content, True)
    except expat.ExpatError as error:
        problem = f"expected XML, which breaks here: {expat.ErrorString(error.code)}"
        raise InputError(problem, where=f"{path}, line {error.lineno}", cure="Is it complete?") from None
    table = np.array(reader.boxes, dtype=np.float64).reshape(-1, 7)
    centre, size = table[:, 2:4], table[:, 4:6]
    origin = Origin(path, "line", table[:, 6].astype(np.int64))
    return Rows(origin, table[:, 0], np.hstack([centre - size / 2, centre + size / 2]), source.first, identity=table[:, 1])


class _Reader:
    """Collects ``boxes``: frame, identity, centre x, centre y, width, height, line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.boxes: list[list[float]] = []
        self.parser = expat.ParserCreate()
        self.parser.StartDoctypeDeclHandler = self.parser.EntityDeclHandler = self._refuse
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = lambda name: self._inside.pop(name, None)
        self._inside: dict[str, float] = {}  # the elements that are open, with their numbers

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if not self._inside and name != "dataset":
            raise self._error(f"expected CVML, whose outermost element is <dataset>, came <{name}>")
        self._inside[name] = self._number(attributes, _NUMBERED[name], name) if name in _NUMBERED else 0.0
        if name == "box" and "group" not in self._inside:
            if "frame" not in self._inside or "object" not in self._inside:
                raise self._error("expected <box> inside of <frame> and <object>, came one outside")
            box = [self._number(attributes, key, "box") for key in ("xc", "yc", "w", "h")]
            line = self.parser.CurrentLineNumber
            self.boxes.append([self._inside["frame"], self._inside["object"], *box, line])

    def _number(self, attributes: dict[str, str], key: str, element: str) -> float:
        if key not in attributes:
            raise self._error(f"expected <{element}> with a value for {key}, came one without")
        try:
            return float(attributes[key])
        except ValueError:
            raise self._error(f"expected a number for {key} of <{element}>, came '{attributes[key]}'") from None

    def _refuse(self, *_: object) -> None:
        problem = "expected CVML without a document type and entities, came a declaration of one"
        raise self._error(problem, "Remove the <!DOCTYPE …> from the file.")

    def _error(self, problem: str, cure: str = "") -> InputError:
        return InputError(problem, where=f"{self.path}, line {self.parser.CurrentLineNumber}", cure=cure)
