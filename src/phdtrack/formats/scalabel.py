"""Scalabel, the JSON of BDD100K: a list of frames with labels, or an object with ``frames``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phdtrack.errors import InputError
from phdtrack.formats.json_entry import brief

_CORNERS = ("x1", "y1", "x2", "y2")


def is_scalabel(document: object) -> bool:
    """True if a JSON document lists frames as Scalabel does."""
    if isinstance(document, dict):
        document = document.get("frames")
    if not isinstance(document, list) or not document:
        return False
    first = document[0]
    return isinstance(first, dict) and "name" in first and "labels" in first


def coco_of_scalabel(path: Path, document: Any) -> dict[str, Any]:
    """The frames of a Scalabel document, for which `is_scalabel` is true, as a COCO data set.

    Labels without a box are left out. Raises `InputError` if a frame or a label is malformed.
    """
    frames = document["frames"] if isinstance(document, dict) else document
    images = list[dict[str, Any]]()
    annotations = list[dict[str, Any]]()
    for place, frame in enumerate(frames):
        where = f"{path}, frame {place + 1} of the list"
        if not isinstance(frame, dict):
            raise InputError(
                f"expected an object with name and labels, got {brief(frame)}", where=where
            )
        image = {"id": place, "file_name": frame.get("name", "")}
        for theirs, ours in (("videoName", "video_id"), ("frameIndex", "frame_id")):
            if frame.get(theirs) is not None:
                image[ours] = frame[theirs]
        images.append(image)
        labels = frame.get("labels") or []
        if not isinstance(labels, list):
            raise InputError(f"expected a list of labels, got {brief(labels)}", where=where)
        for label in labels:
            made = _annotation(label, where)
            if made is not None:
                annotations.append({**made, "image_id": place})
    numbers = _numbered(annotations)
    categories = [{"id": number, "name": name} for name, number in numbers.items()]
    return {"images": images, "annotations": annotations, "categories": categories}


def _annotation(label: Any, where: str) -> dict[str, Any] | None:
    """A label as an annotation of COCO without its image; None if it has no box."""
    if not isinstance(label, dict):
        raise InputError(f"expected an object for a label, got {brief(label)}", where=where)
    box = label.get("box2d")
    if box is None:
        return None
    values = [box.get(name) for name in _CORNERS] if isinstance(box, dict) else []
    corners = [float(one) for one in values if isinstance(one, int | float)]
    if len(corners) != 4:
        raise InputError(f"expected numbers for x1, y1, x2, y2, got {brief(box)}", where=where)
    left, top, right, bottom = corners
    made: dict[str, Any] = {"bbox": [left, top, right - left, bottom - top]}
    made["category"] = str(label.get("category", ""))
    for name in ("id", "score"):
        if label.get(name) is not None:
            made["track_id" if name == "id" else name] = label[name]
    attributes = label.get("attributes")
    if isinstance(attributes, dict) and attributes.get("crowd") is True:
        made["iscrowd"] = 1
    return made


def _numbered(annotations: list[dict[str, Any]]) -> dict[str, int]:
    """Give annotations the numbers of their categories and identities that are words; the numbers
    of the categories by their name.
    """
    names = sorted({made["category"] for made in annotations})
    category = {name: number for number, name in enumerate(names, start=1)}
    words = sorted({str(made["track_id"]) for made in annotations if "track_id" in made})
    if not all(word.isdecimal() for word in words):
        identity = {word: number for number, word in enumerate(words, start=1)}
        for made in annotations:
            if "track_id" in made:
                made["track_id"] = identity[str(made["track_id"])]
    for made in annotations:
        made["category_id"] = category[made.pop("category")]
    return category
