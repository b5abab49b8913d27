"""Numbers of frames in the names of images: the last digits of a name, without the hashes that some
tools append.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path, PurePosixPath

from phdtrack.errors import InputError
from phdtrack.formats.text import Text, is_number

# Hashes at the end of names: Roboflow's, UUIDs, and other long hexadecimal numbers with a letter.
_HASH = re.compile(
    r"(_[a-z]{3,4})?\.rf\.\w+$"
    r"|(^|[._-])[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$"
    r"|(^|[._-])(?=\d*[a-f])[0-9a-f]{16,}$",
    re.IGNORECASE,
)
_LAST_DIGITS = re.compile(r"([0-9]+)[^0-9]*$")
# Names that a header gives the column of images.
COLUMNS = ("image", "image_name", "image_path", "img", "img_name", "filename", "file_name", "file")


def last_digits(name: PurePosixPath) -> str:
    """The last digits in the name of an image; empty if it has none."""
    match = _LAST_DIGITS.search(_HASH.sub("", name.stem))
    return match[1] if match else ""


def with_frame_numbers(
    text: Text, frame_columns: tuple[str, ...], path: Path
) -> tuple[Text, list[str]]:
    """The table with the numbers of frames in place of the names of images, and a sentence about
    it; the table as it is and no sentence, if it numbers its frames.

    Parameters
    ----------
    text : a table with a header.
    frame_columns : names of the column of frame numbers.
    path : its file, for errors.

    Raises
    ------
    InputError : the images are of several videos.
    """
    name = next((each for each in (*frame_columns, *COLUMNS) if each in text.header), "")
    if not name or not len(text):
        return text, []
    place = text.header.index(name)
    first = [*text.cells(0), *[""] * len(text.header)][place]
    if name in frame_columns and (is_number(first) or not last_digits(_path(first))):
        return text, []
    lines = []
    videos = dict[str, str]()
    for row in range(len(text)):
        cells = text.cells(row)
        if len(cells) > place:
            image = _path(cells[place])
            digits = last_digits(image)
            if digits:
                before = str(image).rpartition(digits)[0]
                videos.setdefault(before, cells[place])
                cells[place] = digits
        lines.append("\t".join(cell.replace("\t", " ") for cell in cells))
    if len(videos) > 1:
        some = ", ".join([*videos.values()][:3])
        raise InputError(
            f"the images in the column {name} are of several videos: {some}",
            where=path,
            cure="Write a file for each video, or number the frames in a column called frame.",
        )
    header = (*text.header[:place], frame_columns[0], *text.header[place + 1 :])
    number = int(last_digits(_path(first)) or 0)
    sentence = f"the column {name} numbers the frames: {first[:60]} is frame {number}"
    return replace(text, lines=lines, delimiter="\t", header=header), [sentence]


def _path(cell: str) -> PurePosixPath:
    return PurePosixPath(cell.replace("\\", "/"))
