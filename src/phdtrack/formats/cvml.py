"""CVML: the XML of CAVIAR's ground truth, in which the truth of PETS 2009 is written too.

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/> ...
                                 <grouplist>  <group id="0"> <members>3,4</members> ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are no objects: they are
passed over by `read_boxes`; `read_groups` gives the membership. A document type or an entity is refused, because that is
how a small file is made to expand without bound; CVML needs neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.rows import Rows, enforce, whole
from phdtrack.formats.text import Origin
from phdtrack.types import I8


@dataclass(frozen=True, slots=True, eq=False)
class GroupMembers:
    """Who belongs to which group when: one row for each member of a group in a frame.

    ``frame`` (M,) from 1, ``group`` (M,), ``member`` (M,) the identity of an object.
    """

    frame: I8
    group: I8
    member: I8

    def __len__(self) -> int:
        return len(self.frame)


def read_groups(path: AnyPath, *, first_frame: int = 0) -> GroupMembers:
    """The annotated groups of a CVML file; ``first_frame`` is the number that it gives the first frame.

    Raises
    ------
    InputError : there is no such file, or it is not well-formed CVML.
    """
    reader = _Reader(Path(path))
    reader.parse(load(path))
    table = np.array(reader.members, dtype=np.float64).reshape(-1, 4)
    origin = Origin(reader.path, "line", table[:, 3].astype(np.int64))
    names = ("member", "group", "frame number")
    enforce(origin, [whole(table[:, 2 - i], name, lowest=first_frame if i == 2 else 0) for i, name in enumerate(names)])
    frame, group, member = table[:, :3].T.astype(np.int64)
    return GroupMembers(frame + (1 - first_frame), group, member)


def rows_of_cvml(path: Path, content: bytes, first: int) -> Rows:
    """The boxes of the objects in a CVML document; ``first`` is the number that it gives the first frame.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    first : the number that the file gives the first frame.

    Raises
    ------
    InputError : the document is not well-formed CVML, or declares a document type.
    """
    reader = _Reader(path)
    reader.parse(content)
    table = np.array(reader.boxes, dtype=np.float64).reshape(-1, 7)
    centre, size = table[:, 2:4], table[:, 4:6]
    origin = Origin(path, "line", table[:, 6].astype(np.int64))
    return Rows(origin, table[:, 0], np.hstack([centre - size / 2, centre + size / 2]), first, identity=table[:, 1])


class _Reader:
    """Walks through the document and collects what it meets: one parse, then it is done.

    ``boxes`` rows: frame, identity, centre x, centre y, width, height, line. ``members`` rows: frame, group, member, line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.boxes: list[tuple[float, ...]] = []
        self.members: list[tuple[float, ...]] = []
        self._frame: float | None = None
        self._object: float | None = None
        self._group: float | None = None
        self._started = False
        self._words: list[str] | None = None
        self._parser = expat.ParserCreate()
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._parser.EntityDeclHandler = self._refuse
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text

    def parse(self, content: bytes) -> None:
        try:
            self._parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise InputError(
                f"expected XML, which breaks here: {reason}",
                where=f"{self.path}, line {error.lineno}",
                cure="Is it complete?",
            ) from None

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if not self._started and name != "dataset":
            raise self._error(f"expected CVML, whose outermost element is <dataset>, came <{name}>")
        self._started = True
        if name == "frame":
            self._frame = self._number(attributes, "number", name)
        elif name == "object":
            self._object = self._number(attributes, "id", name)
        elif name == "group":
            self._group = self._number(attributes, "id", name)
        elif name == "box" and self._group is None:
            self._box(attributes)
        elif name == "members" and self._group is not None:
            self._words = []

    def _box(self, attributes: dict[str, str]) -> None:
        if self._frame is None or self._object is None:
            raise self._error("expected <box> inside of <frame> and <object>, came one outside")
        box = [self._number(attributes, key, "box") for key in ("xc", "yc", "w", "h")]
        self.boxes.append((self._frame, self._object, *box, self._parser.CurrentLineNumber))

    def _text(self, text: str) -> None:
        if self._words is not None:
            self._words.append(text)

    def _end(self, name: str) -> None:
        if name == "members" and self._words is not None:
            self._take_members("".join(self._words))
            self._words = None
        elif name == "frame":
            self._frame = None
        elif name == "object":
            self._object = None
        elif name == "group":
            self._group = None

    def _take_members(self, text: str) -> None:
        if self._frame is None or self._group is None:
            raise self._error("expected <members> inside of <frame> and <group>, came some outside")
        for word in text.replace(",", " ").split():
            member = self._float(word, f"a member of group {self._group:.0f}")
            self.members.append((self._frame, self._group, member, self._parser.CurrentLineNumber))

    def _number(self, attributes: dict[str, str], key: str, element: str) -> float:
        if key not in attributes:
            raise self._error(f"expected <{element}> with a value for {key}, came one without")
        return self._float(attributes[key], f"{key} of <{element}>")

    def _float(self, text: str, name: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise self._error(f"expected a number for {name}, came '{text}'") from None

    def _refuse(self, *_: object) -> None:
        problem = "expected CVML without a document type and entities, came a declaration of one"
        raise self._error(problem, "Remove the <!DOCTYPE …> from the file.")

    def _error(self, problem: str, cure: str = "") -> InputError:
        return InputError(problem, where=f"{self.path}, line {self._parser.CurrentLineNumber}", cure=cure)
