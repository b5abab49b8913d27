"""`Tracker`: the thin stateful face of the pipeline, for a loop of one's own.

tracker = Tracker(frame_size=(1920, 1080), fps=30)
for boxes in detections:                      # (N, 4…6) arrays, or objects with .xyxy
    for identity, box in tracker.update(boxes):
        ...
corrected = tracker.tracks()
"""

from __future__ import annotations

import logging
import math
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack, cast

import numpy as np

from phdtrack import config, pipeline
from phdtrack.associate.history import HISTORY
from phdtrack.detect.box_data import BoxDataBuffer, as_box_data
from phdtrack.detect.colours import Colours
from phdtrack.detect.convert import (
    DetectorOutput,
    DiscardedBoxes,
    HasBoxes,
    HasResult,
    as_detections,
    as_embeddings,
    sizes_warning,
    unit_warning,
)
from phdtrack.errors import DEFERRED, INTERRUPTING, InputError, later
from phdtrack.input_checks import StreamSeen, checks_of, longest_delay
from phdtrack.models.warp import as_warp
from phdtrack.multiclass import ClassPipelines, ClassSettings
from phdtrack.protocols import AnyStages
from phdtrack.types import (
    I8,
    LAST_FRAME,
    STILL,
    Detections,
    Exchange,
    Image,
    Matrix,
    Return,
    SequenceInfo,
    Step,
    SupportsArray,
    Tracks,
)

if TYPE_CHECKING:
    from phdtrack.config.section_types import (
        FilterKind,
        FilterSection,
        PresetName,
        Sections,
        TrackerSections,
    )

_LOG = logging.getLogger(__name__)
# The keys of a saved state.
_SAVED = {"format", "frame_size", "dim", "settings", "state"}
# The functions behind those of `signal`, which look handlers up among its enumerations: three calls
# would take longer than most kernels.
_SIGNALS: Any = import_module("_signal")
# The context of `uninterrupted` where nothing is to be done.
_ANYWHERE = nullcontext()
# Stands for the classes of detections that are all of one.
_ONE_CLASS: I8 = np.zeros(0, np.int64)


class SavedWarnings(NamedTuple):
    """The warnings so far, except those of boxes left out, and whether one was of units."""

    sentences: tuple[str, ...] = ()
    of_units: bool = False


class Tracker:
    """Detections in, tracks with identities out; one call per frame.

    Memory is bounded: the last ten minutes are remembered, some 100 MB with ten targets at 25 fps,
    embeddings with 4 bytes a number besides. `tracks` goes back so far and a little more.
    `FinalTracks` gives the corrected rows of a loop without end. ``associate={"history": S}``
    remembers S seconds, and 0 everything.

    Parameters
    ----------
    frame_size : width and height of the images in pixels.
    fps : frames per second, used if `update` gets no timestamp.
    seed : seed of the particle filter's randomness; the same seed and detections give the same
        tracks.
    filter : ``pmb``, ``pmbm``, ``gm-phd``, ``particle-phd``, ``gm-cphd``, ``particle-cphd``,
        ``mht``, ``mcmc``, or ``none`` for the association alone; or the settings of that section.
    preset : a name of `config.presets.PRESETS`; empty for the usual one with this filter.
    settings : a TOML file with settings.
    stages : one's own model, filter, extractor and associator, instead of all of the above but fps
        and seed; `ClassSettings` where classes have stages of their own.
    **sections : settings by section, as ``sensor={"detection_probability": 0.9}``;
        ``classes={"together": [[2, 7]]}`` for a detector's classes, which are tracked apart.
        `config.section_types.TrackerSections` lists them for type checkers and editors.

    Attributes
    ----------
    on_warning : called with each warning, a sentence with its cure; by default the logger
        ``phdtrack.tracker`` has them.

    Raises
    ------
    InputError : an unknown name, a value out of bounds, or neither ``frame_size`` nor ``stages``.
    """

    def __init__(
        self,
        frame_size: tuple[int, int] | Sequence[int] | None = None,
        *,
        fps: float = 25.0,
        seed: int = 0,
        filter: FilterKind | FilterSection | Literal[""] = "",
        preset: PresetName | Literal[""] = "",
        settings: str | Path | None = None,
        stages: AnyStages | ClassSettings | None = None,
        **sections: Unpack[TrackerSections],
    ) -> None:
        if not 0 < _number(fps, "Tracker(fps=…)") < math.inf:
            raise InputError(
                f"expected frames per second above 0, got {fps!r}", where="Tracker(fps=…)"
            )
        if _whole(seed, "Tracker(seed=…)") < 0:
            raise InputError(f"expected a seed from 0, got {seed}", where="Tracker(seed=…)")
        # Whether to warn when frames are forgotten; the size of the frames if the settings are for
        # one.
        self._forgets = False
        self._frame_size = ""
        if stages is None:
            if frame_size is None:
                cure = "Give frame_size=(width, height)"
                raise InputError("the size of the images is not known", where="Tracker", cure=cure)
            path = None if settings is None else Path(settings)
            stated = cast("Sections", {**sections})
            if filter:
                stated["filter"] = {"kind": filter} if isinstance(filter, str) else filter
            loaded = config.overlay(config.load(path, preset=preset), stated, "Tracker")
            self._forgets = "history" not in loaded.given.get("associate", {})
            width, height = _size(frame_size)
            self._frame_size = f"{width}x{height}"
            stages = config.build_classes(loaded, SequenceInfo(width, height, float(fps)))
        elif sections or settings is not None or preset or filter:
            raise InputError(
                "stages are complete; settings beside them would be ignored", where="Tracker"
            )
        self.classes = stages if isinstance(stages, ClassSettings) else ClassSettings(stages)
        self.stages = self.classes.usual
        self.fps = float(fps)
        self.seed = int(seed)
        self.sequences = 0
        self.on_warning: Callable[[str], None] = _LOG.warning
        self._checks = checks_of(self.classes, self.fps)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next frame is the first of a new sequence, and identities start at
        1 again. ``sequences`` counts how often this, or `load_state_dict`, has begun one.
        """
        self._pipelines = ClassPipelines(self.classes, self.seed)
        self._step: Step | None = None
        self._left_out = DiscardedBoxes()
        self._begun = math.nan
        self._first = 0
        self._warnings = SavedWarnings()
        self._seen = StreamSeen()
        # Numbers of an embedding; 0 before the first one.
        self._embedding_length = 0
        self._box_data = BoxDataBuffer(longest_delay(self.classes))
        self.sequences += 1

    def update(
        self,
        detections: DetectorOutput,
        frame: int | None = None,
        timestamp: float | None = None,
        warp: Matrix | None = None,
        embeddings: Matrix | None = None,
        image: SupportsArray | None = None,
        data: Mapping[str, object] | HasBoxes | HasResult | None = None,
    ) -> Tracks:
        """Take in one frame's detections; give the online rows that became final, which will not
        change: of this frame, or with an output delay of an earlier one.

        The appearance of the boxes is evidence of who is who, if it is given: as ``embeddings`` of
        a network, or as colours that are read from the ``image``. What it is worth is learned from
        the stream.

        Parameters
        ----------
        detections : (N, 4…6) array of left, top, right, bottom[, confidence[, class]] in pixels, or
            an object with ``.xyxy`` (and ``.confidence``, ``.class_id``); empty for a frame in
            which nothing was detected; `Detections.empty(observed=False)` for a frame without
            detection. Boxes that no picture shows, and those that are too many (``limits``), are
            left out and counted in `left_out`.
        frame : its number from 1; default one more than the last. Numbers left out are frames that
            were dropped.
        timestamp : its time in seconds; default from the number and ``fps``.
        warp : how the camera moved since the last update: the (3, 3) homography, or (2, 3) affine
            map, that takes pixels of that frame to this one's, as `CameraMotion` measures it;
            default: it stands still.
        embeddings : (N, D), a row for each box in their order, of any scale; zeros or NaN if it is
            unknown. They replace those of the object.
        image : (H, W, 3) uint8, the picture in which the boxes are, in place of embeddings; or
            (H, W) in grey. Blue, green, red as OpenCV reads it; another order is as good.
        data : anything else of the boxes, as ``{"masks": masks, "names": names}``: arrays, tensors
            or lists with an entry for each box, in their order; or the object of supervision or
            Ultralytics, whose own data, masks and keypoints it means. `Tracks.data` gives it back
            by row; it decides nothing.

        Raises
        ------
        InputError : boxes that are none, a frame that does not come after the last, a warp that is
            none, or one for a model that lies at fixed pixels or on the ground; embeddings of
            another number of boxes, or of another length than before; data of another number
            of boxes; an image of another size than the frames, or beside embeddings.
        KeyboardInterrupt : after Ctrl-C, when the frame is done; a second Ctrl-C ends at once.
        """
        number, time = self._moment(frame, timestamp)
        where = f"frame {number}"
        found = as_detections(detections, where=where)
        if isinstance(detections, Detections):
            found = found.numbered()
        if embeddings is not None and image is not None:
            raise InputError(
                "got embeddings and an image, and each says what the boxes look like",
                where=f"{where}, update(image=…)",
                cure="Give one of them.",
            )
        if embeddings is not None:
            place = f"{where}, update(embeddings=…)"
            found = replace(found, embeddings=as_embeddings(embeddings, len(found), place))
        moved = STILL
        if warp is not None:
            moved = as_warp(warp, f"{where}, update(warp=…)")
        columns = {} if data is None else as_box_data(data, len(found), where)
        if len(moved):
            from phdtrack.models.scene import refuse_standing

            refuse_standing(self.stages.model)
        tracked, left_out = self.classes.within_limits(found, self._pipelines.labels)
        if image is not None:
            picture = self._picture(image, f"{where}, update(image=…)")
            tracked = replace(tracked, embeddings=Colours().describe(picture, tracked.xyxy))
        length = self._embedding_length_of(tracked, where)
        with uninterrupted():
            self._step = self._pipelines.advance(tracked, number, time, moved)
            doubts = self._check(self._step)
        self._embedding_length = length
        self._warn(number, time, found, left_out, doubts)
        if any(left_out):
            self._left_out = self._left_out.with_more(left_out)
        if found.observed:
            self._box_data.add(number, columns, len(found))
        return self._box_data.attached(self._step.tracks)

    def _moment(self, frame: int | None, timestamp: float | None) -> tuple[int, float]:
        """Number and time of the frame of an `update`. Raises `InputError` as it says."""
        last = self._pipelines.state
        number = last.number + 1
        if frame is not None:
            number = _whole(frame, "update(frame=…)")
        if not 1 <= number <= LAST_FRAME:
            raise InputError(
                f"expected a frame number from 1 to {LAST_FRAME:,}, got {number}",
                where="update(frame=…)",
                cure="A loop that counts from 0 says frame=k + 1." if number == 0 else "",
            )
        if timestamp is not None:
            return number, _number(timestamp, f"frame {number}, update(timestamp=…)")
        return number, last.time + (number - (last.number or 1)) / self.fps

    def _picture(self, image: SupportsArray, where: str) -> Image:
        """(H, W, 3) the picture of a frame. Raises `InputError` unless it is one, of the frames'
        size.
        """
        picture = np.asarray(image)
        if picture.ndim == 2 and picture.dtype == np.uint8:
            picture = np.repeat(picture[..., None], 3, axis=2)
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise InputError(
                "expected an image (H, W, 3) or (H, W) of uint8, got an array"
                f" {picture.shape} of {picture.dtype}",
                where=where,
            )
        height, width = picture.shape[:2]
        size = self.classes.limits.frame_size
        if min(size) > 0 and (width, height) != size:
            raise InputError(
                f"expected an image of {size[0]:g}x{size[1]:g} pixels, got one of {width}x{height}",
                where=where,
                cure="Give the image whose pixels the boxes count, and its size as frame_size.",
            )
        return picture

    def _embedding_length_of(self, found: Detections, where: str) -> int:
        """The length of embeddings up to a frame; 0 if there were none. Raises `InputError` if they
        have another one than before.
        """
        if found.embeddings is None or not len(found):
            return self._embedding_length
        length = int(found.embeddings.shape[1])
        if self._embedding_length and length != self._embedding_length:
            raise InputError(
                f"expected embeddings of {self._embedding_length} numbers as before, got {length}",
                where=where,
                cure="Use one network for all frames of a sequence, or call reset().",
            )
        return length

    def _check(self, step: Step) -> tuple[str, ...]:
        """Check whether the stream fits what is assumed of it: warnings if not."""
        labels = _ONE_CLASS
        if self._pipelines.several:
            labels = self.classes.tracked_as(step.detections)
        self._seen, doubts = self._checks.advance(self._seen, step, labels)
        return doubts

    def _warn(
        self,
        number: int,
        time: float,
        found: Detections,
        left_out: DiscardedBoxes,
        doubts: tuple[str, ...],
    ) -> None:
        """Warn of what is new in a frame: boxes left out, implausible units, doubts, and forgotten
        frames.
        """
        if any(left_out):
            for sentence in left_out.sentences(self._left_out):
                self.on_warning(f"frame {number}: {sentence}")
        if not self._warnings.of_units:
            warning = unit_warning(found, self.classes.limits.frame_size)
            if left_out.empty and not warning:
                warning = sizes_warning(found)
            if warning:
                self._warnings = self._warnings._replace(of_units=True)
                self._say(f"frame {number}: {warning}")
        for warning in doubts:
            self._say(f"frame {number}: {warning}")
        self._warn_of_forgetting(number, time)

    def _say(self, sentence: str) -> None:
        """Warn, and remember it."""
        kept = (*self._warnings.sentences, sentence)
        self._warnings = self._warnings._replace(sentences=kept)
        self.on_warning(sentence)

    def warm_up(self) -> None:
        """Compile the kernels that these settings use, or load those that are kept, now and not in
        the first updates.

        Another tracker of the same settings gets frames of made-up boxes; the results of this one
        stay the same to the bit. Without it the first update of a new installation takes about
        half a minute, which the logger ``phdtrack`` says, and that of each later process one or
        two seconds.
        """
        pipelines = ClassPipelines(self.classes, self.seed)
        seen = StreamSeen()
        rng = np.random.default_rng(0)
        n = 8
        limits = self.classes.limits
        size = np.array((1920.0, 1080.0))
        if min(limits.frame_size) > 0:
            size = np.array(limits.frame_size)
        # Side by side, so that some compete for detections, and through the lower half, where a
        # camera sees the ground.
        start = np.linspace([0.2, 0.55], [0.7, 0.9], n)
        step = np.array([0.004, 0.001])
        for k in range(1, 26):
            shown = start[:0]
            if k % 8:
                shown = start[rng.random(n) < 0.8]
            corner = np.vstack([shown + k * step, rng.random((k % 3, 2))]) * size
            box = np.hstack([corner, corner + [0.03, 0.15] * size])
            label = np.resize([*self.classes.only, *self.classes.own] or [0], len(box))
            found = Detections.of(box, rng.uniform(0.3, 1.0, len(box)), label)
            unit_warning(as_detections(found), limits.frame_size)
            with uninterrupted():
                made = pipelines.advance(self.classes.within_limits(found)[0], k, k / self.fps)
                seen = self._checks.advance(seen, made, _ONE_CLASS)[0]
        # A camera that moves; models on the ground take no warp.
        shift = np.array([[1.0, 0.0, 4.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        with uninterrupted(), suppress(InputError):
            pipelines.advance(found, 26, 26 / self.fps, shift)
        # A frame in which no detector runs.
        with uninterrupted():
            pipelines.advance(Detections.empty(observed=False), 27, 27 / self.fps)
        pipelines.flush()
        pipelines.finish()
        Colours().describe(np.zeros((64, 64, 3), np.uint8), np.array([[8.0, 8.0, 24.0, 56.0]]))
        # More than may be in one place.
        crowd = found.select(np.zeros(limits.max_in_one_place + 1, np.int64))
        self.classes.within_limits(crowd)

    def _warn_of_forgetting(self, number: int, time: float) -> None:
        """Warn once, when the first frame is forgotten and no setting asks for it."""
        if math.isnan(self._begun):
            self._begun = time
            self._first = number
        # A slow stream's history is longer: it goes by the filter's time.
        if self._forgets and time - self._begun > HISTORY and self._pipelines.oldest > self._first:
            self._forgets = False
            self._say(
                f"what is older than some {HISTORY / 60:g} minutes is forgotten from now on, so"
                " that memory stays bounded: tracks() goes no further back. FinalTracks gives"
                " corrected rows as they become final; associate={'history': 0} keeps all"
            )

    def trust_times(self) -> None:
        """From now on warn of no times that jump or look wrong, as for a camera that is switched
        off at times.
        """
        self._checks = replace(self._checks, trusts_times=True)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of this sequence so far, except those of boxes left out."""
        return self._warnings.sentences

    @property
    def left_out(self) -> DiscardedBoxes:
        """How many boxes were left out, and why."""
        return self._left_out

    def flush(self) -> Tracks:
        """At the end, the online rows that the output delay holds back: a later `update` gives them
        again.
        """
        return self._box_data.attached(self._pipelines.flush())

    def tracks(self) -> Tracks:
        """The corrected tracks of everything so far: short ones left out, gaps bridged, identities
        of their own. They have no `Tracks.data`, which nobody could keep for so long.
        """
        return self._pipelines.finish()

    @property
    def returns(self) -> tuple[Return, ...]:
        """The identities that online rows have taken again so far, oldest first: of targets that
        were lost, came back and look the same.
        """
        return self._pipelines.returns

    @property
    def exchanges(self) -> tuple[Exchange, ...]:
        """The identities that two targets of online rows have exchanged so far, oldest first: they
        had met, and each looked like the other one since.
        """
        return self._pipelines.exchanges

    @property
    def drawn(self) -> bool:
        """True if anything was drawn at random so far."""
        return self._pipelines.drawn

    @property
    def highest(self) -> int:
        """The highest identity that online rows had so far."""
        return self._pipelines.highest

    def skip_identities(self, count: int) -> None:
        """Give none of the next ``count`` identities, as those of another run."""
        self._pipelines.skip(count)

    @property
    def step(self) -> Step | None:
        """Everything the last update brought: detections but those left out, info, states, rows,
        times. None at first.
        """
        return self._step

    @property
    def state(self) -> pipeline.TrackingState:
        """The filter's and the associator's state, and what was learned; of several classes that of
        the first seen.
        """
        return self._pipelines.state

    @property
    def states(self) -> dict[int, pipeline.TrackingState]:
        """The same of each class seen so far."""
        return self._pipelines.states

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next, as numbers, texts and bytes with a checksum (it
        can be pickled). The ``data`` of boxes decides nothing: where an output delay still holds
        rows back, these have empty entries after `load_state_dict`.
        """
        return self.snapshot()()

    def snapshot(self) -> Callable[[], dict[str, Any]]:
        """A function that returns the `state_dict` of now, also later and in another thread; the
        call itself takes next to no time.
        """
        from phdtrack.state import FORMAT, settings_digest, to_bytes

        whole, pipelines = self._pipelines.saved()
        state = {
            "whole": whole,
            "pipelines": pipelines,
            "left_out": self._left_out,
            "warnings": self._warnings,
            "seen": self._seen,
            "embedding_length": self._embedding_length,
        }
        return lambda: {
            "format": FORMAT,
            "frame_size": self._frame_size,
            "dim": self.stages.model.motion.dim,
            "settings": settings_digest(self.classes),
            "state": to_bytes(state),
        }

    def load_state_dict(self, saved: dict[str, Any], *, same_settings: bool = True) -> None:
        """Continue from a `state_dict` of a tracker with the same settings.

        Parameters
        ----------
        saved : what `state_dict` returned.
        same_settings : False accepts a state of other settings of the same kinds of parts, in which
            numbers have changed that no array's size depends on.

        Raises
        ------
        InputError : it is no such state, damaged, of another format, of frames of another size, or
            of other settings. The tracker stays as it was.
        """
        from phdtrack.state import from_bytes, unpack

        where = "load_state_dict"
        self._check_saved(saved, where, same_settings)
        state = from_bytes(saved["state"], where)
        pipelines = ClassPipelines(self.classes, self.seed)
        pipelines.restore(state["whole"], state["pipelines"], where)
        left_out: DiscardedBoxes = unpack(
            state["left_out"], DiscardedBoxes, where=f"{where}, left_out"
        )
        warnings: SavedWarnings = unpack(
            state["warnings"], SavedWarnings, where=f"{where}, warnings"
        )
        seen: StreamSeen = unpack(state["seen"], StreamSeen, where=f"{where}, seen")
        self._pipelines = pipelines
        self._step = None
        self._left_out = left_out
        self._warnings = warnings
        self._seen = seen.resumed()
        self._embedding_length = int(state.get("embedding_length", 0))
        self._box_data = BoxDataBuffer(longest_delay(self.classes))
        self.sequences += 1

    def _check_saved(self, saved: Any, where: str, same_settings: bool) -> None:
        """Raise `InputError` unless this is a saved state that belongs to this tracker."""
        from phdtrack.state import FORMAT, other_format, settings_digest

        if not isinstance(saved, dict) or "format" not in saved:
            raise InputError("expected a state of a tracker", where=where)
        if saved["format"] != FORMAT:
            raise other_format(saved["format"], where)
        if saved.keys() != _SAVED or not isinstance(saved["state"], bytes):
            raise InputError("expected a state of a tracker", where=where)
        size = saved["frame_size"]
        dim = self.stages.model.motion.dim
        problem = ""
        if size and self._frame_size and size != self._frame_size:
            problem = f"expected a state of frames of {self._frame_size}, got one of {size}"
        elif saved["dim"] != dim:
            problem = f"expected states of {dim} components, got {saved['dim']}"
        elif same_settings and saved["settings"] != settings_digest(self.classes):
            problem = "expected a state of a tracker with the same settings"
        if problem:
            cure = "Load it into a tracker with the settings of the one that it is from"
            raise InputError(problem, where=where, cure=cure)


class _Deferring:
    """The context of `uninterrupted` in the main thread, whose ``handler`` it puts back."""

    def __init__(self, handler: Any) -> None:
        self._handler = handler

    def __enter__(self) -> None:
        _SIGNALS.signal(signal.SIGINT, later)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        _SIGNALS.signal(signal.SIGINT, self._handler)
        came = [*DEFERRED]
        DEFERRED.clear()
        if came and kind is None:
            self._handler(came[0], None)


def uninterrupted() -> AbstractContextManager[None]:
    """Ctrl-C that comes within the block is raised at its end, a second one at once.

    Numba makes Python objects of what compiled code gives back, and crashes where that is
    interrupted. This is for the main thread, where Ctrl-C comes, and where it raises
    KeyboardInterrupt (`INTERRUPTING`); other handlers are left alone.
    """
    main = threading.current_thread() is threading.main_thread()
    handler = _SIGNALS.getsignal(signal.SIGINT)
    if main and handler in INTERRUPTING:
        return _Deferring(handler)
    return _ANYWHERE


def _number(value: Any, where: str) -> float:
    """``value`` as a float, where it is a number."""
    if not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(f"expected a number, got {value!r}", where=where)
    return float(value)


def _whole(value: Any, where: str) -> int:
    """``value`` as an integer, where it is a whole number (OpenCV tells frame numbers as
    floats).
    """
    if not _number(value, where).is_integer():
        raise InputError(f"expected a whole number, got {value!r}", where=where)
    return int(value)


def _size(frame_size: Any) -> tuple[int, int]:
    """Width and height in whole pixels."""
    where = "Tracker(frame_size=…)"
    if not isinstance(frame_size, (tuple, list, np.ndarray)) or len(frame_size) != 2:
        raise InputError(f"expected (width, height) in pixels, got {frame_size!r}", where=where)
    width, height = (_whole(side, where) for side in frame_size)
    if width < 1 or height < 1:
        raise InputError(
            f"expected a width and height of at least one pixel, got {width}x{height}", where=where
        )
    return width, height


__all__ = ["Detections", "Tracker"]
