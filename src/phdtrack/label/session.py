"""What a person who labels looks at: stills with their detections, the clips about them, boxes like the one at hand,
suggestions, what was learned so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np

from phdtrack.arrays import iou, to_cxcywh
from phdtrack.errors import InputError
from phdtrack.label.births import all_frames, clip
from phdtrack.label.store import Label, LabelStore, Mark
from phdtrack.label.suggestions import ALIKE, NOTHING, REASONS, TICKED, Answer
from phdtrack.scene import RecursiveEM
from phdtrack.scene.mixture import place_map
from phdtrack.scene.training import box_density
from phdtrack.types import F8, DetectionTable, Image, SequenceInfo, Tracks

_FEWEST = 10
_MAP_WIDTH = 320
# Red and green, as blue, green, red.
_COLOURS: Mapping[str, tuple[int, int, int]] = {"false": (40, 40, 220), "birth": (90, 170, 30)}
_OUTLINE = (62, 210, 255)
# Crops that are shown at once; the next ones follow when these are dealt with. Their size in pixels.
_CROPS, _SIDE = 600, 96


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One labelling: ``store`` keeps the marks, ``table`` has the detections, ``stills`` the frames as JPEG by number, those
    of the clips too, of any size.

    Frames without a picture are shown on grey.
    """

    store: LabelStore
    table: DetectionTable
    stills: Mapping[int, bytes]
    info: SequenceInfo
    suggester: Callable[[], Answer] = lambda: Answer(1.0, NOTHING)

    def overview(self) -> dict[str, object]:
        """Size, name, the frames with how far each is, and the progress."""
        progress, last = self.store.progress(), all_frames(self.info, self.table)[-1]
        clips = [(number, done, clip(number, last)) for number, done in self.store.frames()]
        return {
            "name": self.info.name,
            "width": self.info.width,
            "height": self.info.height,
            "fps": self.info.fps,
            "frames": [{"number": number, "done": done, "clip": [c.start, c.stop - 1]} for number, done, c in clips],
            "progress": asdict(progress),
        }

    def frame(self, number: int) -> dict[str, object]:
        """The boxes of a frame (left, top, right, bottom, score), their marks by index, and what can be undone."""
        found = self.table.at(self._seen(number))
        undo, redo = self.store.steps(number)
        return {
            "number": number,
            "boxes": np.column_stack([found.xyxy, found.confidence]).round(2).tolist(),
            "marks": {str(label.box): label.mark for label in self.store.labels(number)},
            "undo": undo,
            "redo": redo,
            "picture": number in self.stills,
        }

    def still(self, number: int) -> bytes:
        """The picture of a frame as JPEG."""
        return self.stills[number] if number in self.stills else _jpeg(self._grey())

    def crop(self, number: int, box: int) -> bytes:
        """The picture of one detection, outlined, with what is around it, as JPEG of at most 96 × 96 pixels."""
        image = self._picture(number)
        height, width = image.shape[:2]
        left, top, right, bottom = self._box(number, box) * width / self.info.width
        margin = 0.2 * max(right - left, bottom - top)
        x, y = max(0, int(left - margin)), max(0, int(top - margin))
        part = image[y : min(height, int(bottom + margin) + 1), x : min(width, int(right + margin) + 1)]
        if part.size == 0:
            part = self._grey()[:_SIDE, :_SIDE]
        scale = _SIDE / max(part.shape[:2])
        size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
        drawn = cv2.resize(part, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        corners = [(round(scale * (a - x)), round(scale * (b - y))) for a, b in ((left, top), (right, bottom))]
        cv2.rectangle(drawn, corners[0], corners[1], _OUTLINE)
        return _jpeg(np.asarray(drawn, np.uint8))

    def alike(self, number: int, box: int) -> list[tuple[int, int]]:
        """(frame, box) of the unmarked detections on all frames to label that lie where this one does, itself included."""
        this = self._box(number, box)
        marked = {(label.frame, label.box) for label in self.store.labels()}
        found = []
        for other, _ in self.store.frames():
            near = np.flatnonzero(iou(this[None], self.table.at(other).xyxy)[0] >= ALIKE)
            found += [(other, int(k)) for k in near if (other, int(k)) not in marked]
        return found

    def suggestions(self) -> dict[str, object]:
        """What may be false, worst first, of what nobody has marked: frame, box, reason, score, place; how far it is.

        ``ticked`` is the score from which it is taken for false unless somebody says otherwise, ``more`` the number of
        suggestions that are left out for now.
        """
        answer = self.suggester()
        marked = {(label.frame, label.box) for label in self.store.labels()}
        found = answer.suggestions or NOTHING
        columns = (found.frame, found.box, found.reason, found.score.round(3), found.place)
        rows = [row for row in zip(*(column.tolist() for column in columns), strict=True) if row[:2] not in marked]
        return {
            "ready": answer.suggestions is not None or bool(answer.problem),
            "share": answer.share,
            "problem": answer.problem,
            "ticked": TICKED,
            "items": [(frame, box, REASONS[reason], score, place) for frame, box, reason, score, place in rows[:_CROPS]],
            "more": max(0, len(rows) - _CROPS),
        }

    def place_map(self, mark: Mark) -> bytes:
        """What was learned of the marked boxes' places so far, as PNG: coloured where they are likely, clear where not."""
        scale = min(1.0, _MAP_WIDTH / self.info.width)
        shape = (max(1, round(self.info.height * scale)), max(1, round(self.info.width * scale)))
        picture = np.zeros((*shape, 4), np.uint8)
        boxes = _marked(self.store.labels(), self.table, mark)
        if boxes.shape[1] >= _FEWEST:
            size = (float(self.info.width), float(self.info.height))
            density = box_density(boxes, size, RecursiveEM())
            picture[..., :3] = _COLOURS[mark]
            # By the square root a place a quarter as likely as the worst is still plain to see.
            picture[..., 3] = (200 * np.sqrt(place_map(density, shape, 1 / scale))).astype(np.uint8)
        done, data = cv2.imencode(".png", picture)
        assert done
        return data.tobytes()

    def checked(self, marks: Sequence[Label]) -> Sequence[Label]:
        """The marks, if all are on detections that exist. Raises `InputError` where not."""
        for label in marks:
            self._box(label.frame, label.box)
        return marks

    def _seen(self, number: int) -> int:
        last = all_frames(self.info, self.table)[-1]
        if not any(number in clip(known, last) for known, _ in self.store.frames()):
            raise InputError(f"frame {number} is not one of those to label")
        return number

    def _box(self, number: int, box: int) -> F8:
        found = self.table.at(self._seen(number)).xyxy
        if not 0 <= box < len(found):
            raise InputError(f"frame {number} has {len(found)} detections, and no number {box}")
        one: F8 = found[box]
        return one

    def _picture(self, number: int) -> Image:
        if number not in self.stills:
            return self._grey()
        image = cv2.imdecode(np.frombuffer(self.stills[number], np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        return np.asarray(image, np.uint8)

    def _grey(self) -> Image:
        return np.full((self.info.height, self.info.width, 3), 96, np.uint8)


def sampled(last: int, count: int, seed: int) -> list[int]:
    """Frames drawn at random, in random order.

    Parameters
    ----------
    last : they are drawn from 1 … last.
    count : how many; all where there are fewer.
    seed : the same seed gives the same frames.

    Returns
    -------
    Frame numbers.
    """
    return [int(number) for number in np.random.default_rng(seed).permutation(last)[:count] + 1]


def looked_at(store: LabelStore, stretch: range | None = None) -> list[int]:
    """The drawn frames that have been looked at, those in ``stretch`` where one is given."""
    return [number for number, looked in store.frames() if looked and (stretch is None or number in stretch)]


def false_boxes(store: LabelStore, table: DetectionTable, stretch: range | None = None) -> F8:
    """The boxes that are marked as false on frames that were `looked_at`: on other frames more may be false.

    Parameters
    ----------
    store, table : the labels, and the detections that they are on.
    stretch : the frames that count; all where it is None.

    Returns
    -------
    (4, n) centres and sizes, pixels.
    """
    done = set(looked_at(store, stretch))
    return _marked([label for label in store.labels() if label.frame in done], table, "false")


def object_boxes(store: LabelStore, table: DetectionTable, stretch: range | None = None) -> F8:
    """The boxes that are not marked as false on frames that were `looked_at`.

    Parameters
    ----------
    store, table, stretch : as in `false_boxes`.

    Returns
    -------
    (4, n) centres and sizes, pixels.
    """
    false, done = _false(store), looked_at(store, stretch)
    found = [box for frame in done for k, box in enumerate(table.at(frame).xyxy) if (frame, k) not in false]
    return to_cxcywh(np.array(found).reshape(-1, 4))


def share_followed(store: LabelStore, tracks: Tracks, stretch: range | None = None) -> float:
    """The share of the false alarms marked on frames that were `looked_at` on which tracks rest.

    Parameters
    ----------
    store, stretch : as in `false_boxes`.
    tracks : made of the same detections.

    Returns
    -------
    (k + 1)/(n + 2) for k of n, Laplace's rule: none of a few does not mean that there never will be one.
    """
    done = set(looked_at(store, stretch))
    false = {pair for pair in _false(store) if pair[0] in done}
    followed = set(zip(tracks.frame.tolist(), tracks.detection.tolist(), strict=True)) & false
    return (len(followed) + 1) / (len(false) + 2)


def _false(store: LabelStore) -> set[tuple[int, int]]:
    """Frame and box of what is marked as false."""
    return {(label.frame, label.box) for label in store.labels() if label.mark == "false"}


def _marked(labels: Sequence[Label], table: DetectionTable, mark: Mark) -> F8:
    """(4, n) centres and sizes of the boxes of ``table`` that carry this mark."""
    boxes = [table.at(label.frame).xyxy[label.box] for label in labels if label.mark == mark]
    return to_cxcywh(np.array(boxes).reshape(-1, 4))


def _jpeg(image: Image) -> bytes:
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert done
    return data.tobytes()
