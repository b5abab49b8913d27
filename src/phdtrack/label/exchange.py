"""Labels in the formats of other tools: CSV, COCO and CVAT are written, COCO and CVAT are read.

COCO and CVAT files have a picture for each frame to label, with an attribute if it is done, and a
box for each object and each false alarm: marked and drawn boxes, and on done frames the detections
without a mark, which are true. A box has the attributes ``mark``, ``labeller`` and ``box``, its
number. So phdtrack reads everything back, and other tools read the objects by their label.

Boxes of another tool, or of other detections, are matched with the detections of their frame so
that the sum of their overlaps (IoU, each at least `ALIKE`) is largest: a matched box is the true
place of its detection, an unmatched one is a missed object.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, cast
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from scipy.optimize import linear_sum_assignment

from phdtrack.arrays import iou
from phdtrack.errors import InputError
from phdtrack.files import csv_text
from phdtrack.formats.annotations import AnnotationFile
from phdtrack.label.samples import clip
from phdtrack.label.store import DRAWN, MARKS, Label, LabelStore, Mark
from phdtrack.label.suggestions import ALIKE
from phdtrack.types import DetectionTable, SequenceInfo

_OBJECT = "object"
_FALSE = "false alarm"
# Files have two decimals: boxes that differ by no more, in pixels, are in the same place.
_SAME = 0.02
_CORNERS = ("xtl", "ytl", "xbr", "ybr")


class Imported(NamedTuple):
    """Counts of an import: marks by kind and done frames; boxes on frames that are not to be
    labelled, and false alarms that match no detection.
    """

    false: int
    objects: int
    drawn: int
    done: int
    elsewhere: int
    unmatched: int


def frames_of(given: AnnotationFile) -> list[int]:
    """The frames to label in a file that phdtrack wrote, in order; empty for other files."""
    order = [
        (place, one["frame"])
        for one in given.pictures
        if (place := _whole(one.get("order"))) is not None
    ]
    return [number for _, number in sorted(order)]


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """Export and import of labels: the store, its detections, and the sequence with its number of
    frames.
    """

    store: LabelStore
    table: DetectionTable
    info: SequenceInfo

    def text(self, kind: str) -> str:
        """The labels as ``csv``, ``json`` (COCO) or ``xml`` (CVAT "for images 1.1")."""
        return {"csv": self._csv, "json": self._coco, "xml": self._cvat}[kind]()

    def import_file(self, given: AnnotationFile, labeller: str = "") -> Imported:
        """Save the marks of a file, with its labellers' names, or ``labeller`` for marks without.

        A frame is done if the file says so and has a box for each of its detections. Raises
        `InputError` if the pictures have another size; nothing changes then.
        """
        for one in given.pictures:
            size = [_whole(one.get(name)) for name in ("width", "height")]
            if all(size) and self.info.width and size != [self.info.width, self.info.height]:
                problem = (
                    f"expected pictures of {self.info.width} x {self.info.height}, got {size[0]} x"
                    f" {size[1]}"
                )
                raise InputError(
                    problem,
                    where=f"frame {one['frame']} of the file",
                    cure="Is it of another video?",
                )
        digest = given.about.get("detections")
        drawn = [number for number, _ in self.store.frames()]
        last = self.info.frames
        # Marks in a clip belong to the drawn frame of the clip.
        home = {frame: number for number in drawn for frame in clip(number, last)} | {
            number: number for number in drawn
        }
        by_frame = dict[int, list[dict[str, Any]]]()
        all_made = list[Label]()
        elsewhere = 0
        for box in given.boxes:
            known = box["frame"] in (home if box.get("mark") == "birth" else drawn)
            elsewhere += not known
            if known:
                by_frame.setdefault(box["frame"], []).append(box)
        for frame, boxes in by_frame.items():
            made = self._labels(frame, boxes, digest)
            all_made += made
            for who in sorted({label.who for label in made}):
                if mine := [label for label in made if label.who == who and label.mark != "none"]:
                    self.store.mark(home[frame], mine, who or labeller)
        seen = Counter({label.frame: 0 for label in all_made})
        done = 0
        seen.update(
            frame for frame, box in {(label.frame, label.box) for label in all_made} if box < DRAWN
        )
        for one in given.pictures:
            number = one["frame"]
            if (
                str(one.get("done")).lower() == "true"
                and number in drawn
                and seen[number] == len(self.table.at(number))
            ):
                self.store.finish(number, who=labeller)
                done += 1
        marks = Counter("drawn" if label.box >= DRAWN else label.mark for label in all_made)
        unmatched = sum(map(len, by_frame.values())) - len(all_made)
        return Imported(
            marks["false"],
            marks["true"] + marks["birth"],
            marks["drawn"],
            done,
            elsewhere,
            unmatched,
        )

    def _labels(self, frame: int, boxes: list[dict[str, Any]], digest: str | None) -> list[Label]:
        """The labels of the boxes of one frame, ``none`` for unchanged true detections; ``digest``
        is that of the detections in the file, None if it is not known.
        """
        found = self.table.at(frame).xyxy
        known = [one for one in self.store.labels(frame) if one.box >= DRAWN]
        numbers = [*range(len(found)), *(one.box for one in known)]
        places = np.concatenate(
            [found, np.array([one.place for one in known], np.float64).reshape(-1, 4)]
        )
        corners = np.array([box["xyxy"] for box in boxes], np.float64)
        overlap = iou(corners, places)
        pairs = zip(*linear_sum_assignment(-np.where(overlap >= ALIKE, overlap, 0)), strict=True)
        partner = {int(i): numbers[k] for i, k in pairs if overlap[i, k] >= ALIKE}
        made = list[Label]()
        free = max([DRAWN, *(one.box + 1 for one in known)])
        for i, box in enumerate(boxes):
            if box.get("mark") in MARKS:
                mark = box.get("mark")
            elif box["label"] == _FALSE:
                mark = "false"
            else:
                mark = "true"
            number = partner.get(i, free)
            own = _whole(box.get("box"))
            if (
                digest == self.store.digest
                and own is not None
                and (own < len(found) or DRAWN <= own < 2 * DRAWN)
            ):
                number = own
            if number >= DRAWN and mark == "false":
                continue
            free += number == free
            moved = number >= DRAWN or float(np.abs(corners[i] - found[number]).max()) > _SAME
            # Boxes that phdtrack wrote of other detections are where those were; edited boxes are
            # where the labeller put them.
            if mark == "none" and moved and (number >= DRAWN or digest is None):
                mark = "true"
            place = cast(tuple[float, float, float, float], tuple(corners[i].tolist()))
            if mark == "true" or (mark == "birth" and moved):
                kept = place
            else:
                kept = None
            made.append(
                Label(frame, number, cast(Mark, mark), kept, str(box.get("labeller") or "")[:100])
            )
        return made

    def _known(self) -> Iterator[tuple[Label, list[float]]]:
        """The labels, and ``none`` for unmarked detections of done frames, with their corners; by
        frame and box.
        """
        labels = {(label.frame, label.box): label for label in self.store.labels()}
        for number, done in self.store.frames():
            for k in range(len(self.table.at(number)) if done else 0):
                labels.setdefault((number, k), Label(number, k, "none"))
        for _, one in sorted(labels.items()):
            if one.place is None:
                place = self.table.at(one.frame).xyxy[one.box].tolist()
            else:
                place = one.place
            yield one, [round(value, 2) for value in place]

    def _pictures(self) -> dict[int, dict[str, Any]]:
        """The attributes of each picture by frame number; empty for frames that are not to be
        labelled but have marks.
        """
        pictures: dict[int, dict[str, Any]] = {label.frame: {} for label in self.store.labels()}
        pictures |= {
            number: {"order": k, "done": done}
            for k, (number, done) in enumerate(self.store.frames())
        }
        return dict(sorted(pictures.items()))

    def _csv(self) -> str:
        head = ("frame", "box", "mark", "left", "top", "right", "bottom", "labeller")
        marks = [
            (one.frame, one.box, one.mark, *at, one.who)
            for one, at in self._known()
            if one.mark != "none"
        ]
        return csv_text([head, *marks])

    def _coco(self) -> str:
        size = {"width": self.info.width, "height": self.info.height}
        images = [
            {"id": number, "frame_id": number, "file_name": f"{number:06d}.jpg", **size, **more}
            for number, more in self._pictures().items()
        ]
        annotations = [
            {
                "id": k,
                "image_id": one.frame,
                "category_id": 2 if one.mark == "false" else 1,
                "bbox": [left, top, round(right - left, 2), round(bottom - top, 2)],
                "area": round((right - left) * (bottom - top), 2),
                "iscrowd": 0,
                "attributes": {"mark": one.mark, "labeller": one.who, "box": one.box},
            }
            for k, (one, (left, top, right, bottom)) in enumerate(self._known(), start=1)
        ]
        names = [{"id": 1, "name": _OBJECT}, {"id": 2, "name": _FALSE}]
        about = {
            "description": f"marks of phdtrack label: {self.info.name}",
            "detections": self.store.digest,
        }
        whole = {"info": about, "images": images, "annotations": annotations, "categories": names}
        return json.dumps(whole, ensure_ascii=False) + "\n"

    def _cvat(self) -> str:
        boxes = dict[int, list[str]]()
        for one, at in self._known():
            corners = " ".join(
                f'{name}="{value:.12g}"' for name, value in zip(_CORNERS, at, strict=True)
            )
            if one.mark == "false":
                label = _FALSE
            else:
                label = _OBJECT
            more = _attributes({"mark": one.mark, "labeller": one.who, "box": one.box})
            boxes.setdefault(one.frame, []).append(
                f'<box label="{label}" occluded="0" {corners} z_order="0">{more}</box>'
            )
        lines = [
            '<?xml version="1.0" encoding="utf-8"?>',
            "<annotations>",
            "<version>1.1</version>",
        ]
        lines.append(f"<meta><phdtrack detections={quoteattr(self.store.digest)}/></meta>")
        for number, picture in self._pictures().items():
            size = f'width="{self.info.width}" height="{self.info.height}"'
            if picture:
                tag = f'<tag label="frame">{_attributes(picture)}</tag>'
            else:
                tag = ""
            lines += [
                f'<image id="{number - 1}" name="{number:06d}.jpg" {size}>{tag}',
                *boxes.get(number, []),
                "</image>",
            ]
        return "\n".join([*lines, "</annotations>"]) + "\n"


def _whole(value: object) -> int | None:
    """A whole number from 0, also in quotes; None for anything else."""
    text = str(value)
    if text.isdecimal() and len(text) <= 10:
        return int(text)
    return None


def _attributes(values: dict[str, Any]) -> str:
    """Attributes as CVAT writes them."""
    words = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in values.items()
    }
    return "".join(
        f"<attribute name={quoteattr(name)}>{escape(word)}</attribute>"
        for name, word in words.items()
    )
