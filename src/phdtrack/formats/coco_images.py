"""Which video the images of a COCO file belong to, and the numbers of their frames.

Images with different ``video_id``, in different folders of several images each, or whose names
repeat, are several videos, of which the user names one. The number of a frame is, in this order:
``frame_id`` (or ``frame_index``, ``frame_number``) of the image, the last digits of its file name
(``img1/000042.jpg``) without the hash that some programs append, its ``id``; the first that all
images have. Frames count from 0 if an image has this number, and from 1 otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from phdtrack.conventions import ALL
from phdtrack.errors import InputError
from phdtrack.formats.image_names import last_digits
from phdtrack.formats.json_entry import Entry
from phdtrack.types import LAST_FRAME

_LISTED = 9


class ImageFrames(NamedTuple):
    """The frames of a COCO file's images.

    Attributes
    ----------
    frame : the number of each image's frame, by the image's id.
    others : the ids of images of other videos.
    first : the number of the first frame.
    notices : sentences about guesses.
    """

    frame: dict[float, float]
    others: frozenset[float]
    first: int
    notices: tuple[str, ...]


def frames_of_images(
    path: Path, images: Sequence[Entry], videos: Mapping[object, str], sequence: str
) -> ImageFrames:
    """The frames of the images of one video. Raises `InputError` if there are several videos, and
    the sequence is none of them, or an id or number is malformed.

    Parameters
    ----------
    path : the file, for messages.
    images : the images.
    videos : the names of the videos by their id.
    sequence : the name of the video to read; ``all`` for all images.
    """
    ids = [image.number("id") for image in images]
    groups = _sequences(images, videos)
    notices = list[str]()
    chosen = list(range(len(images)))
    if len(groups) > 1 and sequence != ALL:
        if sequence not in groups:
            raise _several(path, list(groups), sequence)
        chosen = groups[sequence]
        notices.append(f"read the video {sequence} of {len(groups)}")
    frames = _numbers([images[k] for k in chosen], [ids[k] for k in chosen], notices)
    first = int(min(frames, default=1.0) != 0.0)
    if not first:
        notices.append("frames count from 0, because an image has this number")
    frame = dict(zip([ids[k] for k in chosen], frames, strict=True))
    return ImageFrames(frame, frozenset(ids) - frame.keys(), first, tuple(notices))


def _several(path: Path, names: list[str], sequence: str) -> InputError:
    """The error for a file of several videos."""
    listed = ", ".join(names[:_LISTED])
    if len(names) > _LISTED:
        listed += ", …"
    problem = f"expected one video, got {len(names)}: {listed}"
    if sequence:
        problem = f"there is no video {sequence!r} among the {len(names)} of the file: {listed}"
    cure = f"Say --sequence {names[0]}, or --sequence all to read them as one."
    return InputError(problem, where=path, cure=cure)


def _sequences(images: Sequence[Entry], videos: Mapping[object, str]) -> dict[str, list[int]]:
    """The images of each video by its name; one entry, or none, if they are of one video."""
    groups = dict[str, list[int]]()
    video_ids = [image.values.get("video_id") for image in images]
    if len({one for one in video_ids if isinstance(one, int | str)}) > 1:
        for k, one in enumerate(video_ids):
            name = str(one)
            if isinstance(one, int | str):
                name = videos.get(one, name)
            groups.setdefault(name, []).append(k)
        return groups
    names = [_file_name(image.values) for image in images]
    for k, folder in enumerate(_folder_names([name.parent.parts for name in names])):
        groups.setdefault(folder, []).append(k)
    if len(groups) > 1 and all(len(group) > 1 for group in groups.values()):
        return groups
    return _repeats(names)


def _folder_names(folders: list[tuple[str, ...]]) -> list[str]:
    """The folders without the parts that are common to all of them, at both ends."""
    if not folders:
        return []
    start = 0
    while len({folder[start : start + 1] for folder in folders}) == 1 and folders[0][start:]:
        start += 1
    rest = [folder[start:] for folder in folders]
    while len({folder[-1:] for folder in rest}) == 1 and rest[0]:
        rest = [folder[:-1] for folder in rest]
    return ["/".join(folder) or "." for folder in rest]


def _repeats(names: list[PurePosixPath]) -> dict[str, list[int]]:
    """The images by how often their names have begun anew."""
    groups = dict[str, list[int]]()
    seen = set[PurePosixPath]()
    number = 1
    for k, name in enumerate(names):
        if name.parts and name in seen:
            number += 1
            seen.clear()
        seen.add(name)
        groups.setdefault(str(number), []).append(k)
    if all(len(group) > 1 for group in groups.values()):
        return groups
    return {}


def _numbers(images: Sequence[Entry], ids: list[float], notices: list[str]) -> list[float]:
    """The frame number of each image."""
    for name in ("frame_id", "frame_index", "frame_number"):
        if images and all(name in image.values for image in images):
            return [image.number(name) for image in images]
    digits = [last_digits(_file_name(image.values)) for image in images]
    words = [word.lstrip("0")[:20] for word in digits if word]
    if not len(words) == len(set(words)) == len(images):
        if len(images) > 1 and all("file_name" in image.values for image in images):
            notices.append(
                "the names of the images do not number frames, and their ids are taken for that"
            )
        return ids
    numbers = [float(word or 0) for word in words]
    if numbers and max(numbers) > LAST_FRAME:
        notices.append("the numbers in the images' names give their order: they are too large")
        order = {number: float(place) for place, number in enumerate(sorted(numbers), start=1)}
        return [order[number] for number in numbers]
    return numbers


def _file_name(values: Mapping[str, Any]) -> PurePosixPath:
    """The name of an image's file, empty without one."""
    name = values.get("file_name", "")
    return PurePosixPath(str(name).replace("\\", "/") if isinstance(name, str) else "")
