"""The content of the page on which a person marks false detections and births. `web.guard` decides
who may use it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, ValidationError
from starlette.applications import Starlette
from starlette.routing import Route

from phdtrack.arrays import iou
from phdtrack.clock import Clock
from phdtrack.errors import InputError
from phdtrack.label.exchange import Exchange
from phdtrack.label.samples import boxes_of, clip
from phdtrack.label.store import DRAWN, Label, LabelStore, Progress
from phdtrack.label.suggestions import ALIKE, TICKED, Background
from phdtrack.opencv_package import cv2
from phdtrack.scene.mixture import place_map
from phdtrack.scene.training import FALSE_BOXES, MIN_BIRTHS, box_density, learn_boxes
from phdtrack.types import F8, Detections, DetectionTable, Image, SequenceInfo
from phdtrack.web.endpoints import JSON, endpoint, static

# Headers of answers by media type: pictures never change, and labels are a file to download.
_OF_TYPE = {
    "image/jpeg": {"Cache-Control": "private, max-age=86400, immutable"},
    "text/csv": {"Content-Disposition": 'attachment; filename="labels.csv"'},
    "application/json; charset=utf-8": {
        "Content-Disposition": 'attachment; filename="labels.coco.json"'
    },
    "text/xml": {"Content-Disposition": 'attachment; filename="labels.cvat.xml"'},
}
STATIC = Path(__file__).parent / "static"
# Marks from which on a map is drawn, and its width; colours are BGR.
_MIN_MARKS = 10
_MAP_WIDTH = 320
# Share of marks without a place above which cross-validation decides if there are places.
_DOUBT = 0.5
_COLOURS = {"false": (40, 40, 220), "birth": (90, 170, 30)}
_OUTLINE = (62, 210, 255)
_GREY = 96
# Crops that are shown at once, and their size in pixels.
_CROPS = 600
_SIDE = 96
# Marks in one request.
MAX_MARKS = 10_000


class Sent(BaseModel):
    """A request that changes a frame: marks and their labeller, or if the frame is done.

    A repeated request has the same ``key``.
    """

    marks: Annotated[list[Label], Field(max_length=MAX_MARKS)] = []
    who: Annotated[str, Field(max_length=100)] = ""
    key: Annotated[str, Field(max_length=100)] = ""
    done: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """The answers of the page; a mapping or a list is sent as JSON, bytes as a picture.

    Attributes
    ----------
    store : the labels.
    table, info : the detections, and the sequence, with the number of its frames.
    stills : frames as JPEG by number, also those of the clips, of any size; others are grey.
    background : looks for suggestions; None without them.
    command : the shell command that learns from the marks.
    labeller : name of the labeller, unless the page gives another one.
    clock : the times of the frames; None for a constant rate.
    """

    store: LabelStore
    table: DetectionTable
    stills: Mapping[int, bytes]
    info: SequenceInfo
    background: Background | None = None
    command: str = "phdtrack learn"
    labeller: str = ""
    clock: Clock | None = None

    @property
    def exchange(self) -> Exchange:
        """The labels in the formats of other tools."""
        return Exchange(self.store, self.table, self.info)

    def learn(self, progress: Progress) -> str:
        """The command that learns from the marks; births too, if enough of them are marked."""
        if progress.births >= MIN_BIRTHS:
            return f"{self.command} --births hand"
        return self.command

    def overview(self) -> dict[str, object]:
        """Size, name, the file of labels (its name, and the path where it is ``kept``), the
        progress, and of each frame the state and its clip: first and last frame, and for how many
        seconds each of them is seen.
        """
        info = self.info
        clock = self.clock or Clock.constant(info.fps)
        clips = [(number, done, clip(number, info.frames)) for number, done in self.store.frames()]
        return {
            "name": info.name,
            "file": self.store.name,
            "width": info.width,
            "height": info.height,
            "frames": [
                {
                    "number": number,
                    "done": done,
                    "clip": [c.start, c.stop - 1],
                    "seconds": np.diff(clock.times([*c, c.stop])).round(3).tolist(),
                }
                for number, done, c in clips
            ],
            "progress": self._progress(),
            "kept": str(self.store.path),
            "labeller": self.labeller,
            "drawn": DRAWN,
        }

    def disputes(self) -> list[tuple[int, int, dict[str, str]]]:
        """(frame, box, mark by labeller) of the boxes that labellers mark differently."""
        return [(*box, marks) for box, marks in self.store.disputes().items()]

    def frame(self, number: int, who: str = "") -> dict[str, object]:
        """The boxes of a frame (left, top, right, bottom, score); by box the marks, their
        labellers, and the places of drawn or moved boxes; if it is done, and what ``who`` can undo
        and redo.
        """
        found = self._boxes(number)
        labels = self.store.labels(number)
        undo, redo = self.store.steps(number, who)
        return {
            "number": number,
            "boxes": np.column_stack([found.xyxy, found.confidence]).round(2).tolist(),
            "marks": {str(label.box): label.mark for label in labels},
            "places": {str(label.box): label.place for label in labels if label.place is not None},
            "by": {str(label.box): label.who for label in labels},
            "done": dict(self.store.frames()).get(number, False),
            "undo": undo,
            "redo": redo,
            "picture": number in self.stills,
        }

    def still(self, number: int) -> bytes:
        """The picture of a frame."""
        self._boxes(number)
        grey = np.full((self.info.height, self.info.width, 3), _GREY, np.uint8)
        if number in self.stills:
            return self.stills[number]
        return _encoded(grey)

    def crop(self, number: int, box: int) -> bytes:
        """The picture of one detection, outlined, with its surroundings, at most 96 × 96 pixels."""
        image = cv2.imdecode(np.frombuffer(self.still(number), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        corners = (self._box(number, box) * image.shape[1] / self.info.width).reshape(2, 2)
        margin = 0.2 * (corners[1] - corners[0]).max()
        (x, y), (right, bottom) = (
            np.maximum([corners[0] - margin, corners[1] + margin + 1], 0).astype(int).tolist()
        )
        part = np.asarray(image[y:bottom, x:right], np.uint8)
        if part.size == 0:
            part = np.full((_SIDE, _SIDE, 3), _GREY, np.uint8)
        scale = _SIDE / max(part.shape[:2])
        size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
        part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
        first, second = (scale * (corners - (x, y))).round().astype(int).tolist()
        cv2.rectangle(part, first, second, _OUTLINE)
        return _encoded(part)

    def alike(self, number: int, box: int) -> list[tuple[int, int]]:
        """(frame, box) of the unmarked detections on all frames to label in the place of this one,
        itself included.
        """
        this = self._box(number, box)
        marked = self._marked
        found = list[tuple[int, int]]()
        for other, _ in self.store.frames():
            near = np.flatnonzero(iou(this[None], self.table.at(other).xyxy)[0] >= ALIKE).tolist()
            found += [(other, k) for k in near if (other, k) not in marked]
        return found

    def suggestions(self) -> dict[str, object]:
        """Suggested false alarms without a mark, worst first: frame, box, reason, score, place; and
        the progress of the search.

        ``ticked`` is the score from which a suggestion is preselected, ``more`` the number of
        suggestions that are left out for now.
        """
        work = self.background
        marked = self._marked
        found = [
            one
            for one in (work.found if work else None) or ()
            if (one.frame, one.box) not in marked
        ]
        return {
            "ready": work is None or work.found is not None or bool(work.problem),
            "share": 1.0 if work is None else work.share,
            "problem": "" if work is None else work.problem,
            "ticked": TICKED,
            "items": [one._replace(score=round(one.score, 3)) for one in found[:_CROPS]],
            "more": max(0, len(found) - _CROPS),
        }

    def place_map(self, mark: str) -> dict[str, object]:
        """True as ``learned`` if the marked boxes have likely places, and a ``picture`` of these as
        a data address: coloured where boxes are likely, clear elsewhere.
        """
        if mark not in _COLOURS:
            raise InputError(f"expected {' or '.join(_COLOURS)}, got {mark!r}")
        scale = min(1.0, _MAP_WIDTH / self.info.width)
        shape = (max(1, round(self.info.height * scale)), max(1, round(self.info.width * scale)))
        picture = np.zeros((*shape, 4), np.uint8)
        boxes = boxes_of([label for label in self.store.labels() if label.mark == mark], self.table)
        if learned := boxes.shape[1] >= _MIN_MARKS:
            size = (float(self.info.width), float(self.info.height))
            density = box_density(boxes, size)
            # In doubt, cross-validation shows how well the places predict other marks.
            if density.uniform >= _DOUBT:
                density = learn_boxes(boxes, 1, size, FALSE_BOXES).learned.density
            learned = density.has_places
        if learned:
            picture[..., :3] = _COLOURS[mark]
            # The square root keeps a place visible that is a quarter as likely as the worst.
            picture[..., 3] = (200 * np.sqrt(place_map(density, shape, 1 / scale))).astype(np.uint8)
        data = base64.b64encode(_encoded(picture, ".png")).decode()
        return {"learned": learned, "picture": f"data:image/png;base64,{data}"}

    def _change(self, number: int, what: str, sent: bytes) -> dict[str, object]:
        """Change a frame; return it and the progress. ``what`` is marks, undo, redo or done.

        Raises `InputError` if ``sent`` is no `Sent` as JSON; nothing changes then.
        """
        try:
            change = Sent.model_validate_json(sent)
        except ValidationError as error:
            first = error.errors()[0]
            raise InputError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        store = self.store
        self._boxes(number)
        match what:
            case "marks":
                found = {
                    number: self._boxes(number)
                    for number in {label.frame for label in change.marks}
                }
                for label in change.marks:
                    if label.box < DRAWN:
                        _checked(found[label.frame], label.frame, label.box)
                store.mark(number, change.marks, change.who, change.key)
            case "undo" | "redo":
                store.undo(number, change.key, change.who, again=what == "redo")
            case "done":
                store.finish(number, change.done, change.key, change.who)
            case _:
                raise InputError(f"nothing is called {what}")
        return self.frame(number, change.who) | {"progress": self._progress()}

    def _progress(self) -> dict[str, object]:
        """The progress, and the ``next`` command when all frames are done."""
        progress = self.store.progress()
        return asdict(progress) | {
            "next": self.learn(progress) if progress.done == progress.frames else ""
        }

    def _boxes(self, number: int) -> Detections:
        """The detections of a frame to label, or of the clip around one."""
        if not any(number in clip(known, self.info.frames) for known, _ in self.store.frames()):
            raise InputError(f"frame {number} is not one of those to label")
        return self.table.at(number)

    def _box(self, number: int, box: int) -> F8:
        """(4,) corners of a detection of such a frame."""
        return _checked(self._boxes(number), number, box)

    @property
    def _marked(self) -> set[tuple[int, int]]:
        """Frame and box of everything that has a mark."""
        return {(label.frame, label.box) for label in self.store.labels()}


def _checked(found: Detections, number: int, box: int) -> F8:
    """(4,) corners of one of the detections of frame ``number``."""
    if not 0 <= box < len(found):
        raise InputError(f"frame {number} has {len(found)} detections, and no number {box}")
    return np.array(found.xyxy[box])


def label_app(session: Session) -> Starlette:
    """The application, without `web.guard`."""
    answers: dict[str, tuple[Callable[..., object], str]] = {
        "/": ((STATIC / "label.html").read_bytes, "text/html; charset=utf-8"),
        "/api/overview": (session.overview, JSON),
        "/api/frame/{number:int}/alike/{box:int}": (session.alike, JSON),
        "/api/suggestions": (session.suggestions, JSON),
        "/api/map/{mark:str}": (session.place_map, JSON),
        "/api/labels.csv": (partial(session.exchange.text, "csv"), "text/csv"),
        "/api/labels.json": (
            partial(session.exchange.text, "json"),
            "application/json; charset=utf-8",
        ),
        "/api/labels.xml": (partial(session.exchange.text, "xml"), "text/xml"),
        "/api/disputes": (session.disputes, JSON),
        "/still/{number:int}.jpg": (session.still, "image/jpeg"),
        "/crop/{number:int}/{box:int}.jpg": (session.crop, "image/jpeg"),
    }
    routes = [
        Route(path, endpoint(work, media, _OF_TYPE.get(media)))
        for path, (work, media) in answers.items()
    ]
    routes.append(Route("/api/frame/{number:int}", endpoint(session.frame, query=["who"])))
    change = Route(
        "/api/frame/{number:int}/{what:str}", endpoint(session._change), methods=["POST"]
    )
    return Starlette(routes=[*routes, change, *static(STATIC)])


def _encoded(image: Image, suffix: str = ".jpg") -> bytes:
    if suffix == ".jpg":
        quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
    else:
        quality = []
    return bytes(cv2.imencode(suffix, image, quality)[1])
