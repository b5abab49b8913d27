"""CVML: the XML of CAVIAR's ground truth, in which the truth of PETS 2009 is written too.

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/> ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are no objects: they are passed
over.
"""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import read_xml
from phdtrack.formats.checks import Origin
from phdtrack.formats.table import CENTRE_SIZE, Column, Source, Table


def table_of_cvml(source: Source) -> Table:
    """The boxes of the objects in a CVML document.

    Raises
    ------
    InputError : the document is not well-formed CVML, or declares a document type.
    """
    elements = read_xml(source.path, source.content)
    if elements[0].name != "dataset":
        came = f"<{elements[0].name}>"
        raise InputError(f"expected CVML, whose outermost element is <dataset>, came {came}", where=elements[0].where)
    rows, lines = [], []
    for box in elements:
        around = {element.name: element for element in box.around}
        if box.name != "box" or "group" in around:
            continue
        if "frame" not in around or "object" not in around:
            raise InputError("expected <box> inside of <frame> and <object>, came one outside", where=box.where)
        place = [box.number(key) for key in ("xc", "yc", "w", "h")]
        rows.append([around["frame"].number("number"), around["object"].number("id"), *place])
        lines.append(box.line)
    values = np.array(rows, np.float64).reshape(-1, 6)
    origin = Origin(source.path, "line", np.array(lines, np.int64))
    columns = dict(zip((Column.FRAME, Column.IDENTITY, *CENTRE_SIZE), values.T, strict=True))
    return Table(origin, source.first, columns, np.zeros((len(values), 0)))
