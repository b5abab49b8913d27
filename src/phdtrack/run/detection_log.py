"""How a run that was killed goes on (``--checkpoint-every`` and ``--resume``), and how the next one
need not detect again.

What takes time in a run is to detect. So a checkpoint holds no state of the tracker:
``checkpoint.log`` has what was detected in every frame, bit for bit, and ``checkpoint.detector``
what the detector knew after one of these frames. A run that is resumed tracks the frames up to that
one again, from the log, and detects from there on. All that it writes is written by the same code
from the same numbers as in a run that was never stopped, and so it is the same.

When all frames were looked at the log becomes ``detections.cache``. Its first block says what
decided it: the file, the detector and its settings. A run in which these are the same takes the
detections from there.
"""

from __future__ import annotations

import json
import os
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from phdtrack import __version__
from phdtrack.detect import knowledge, restore
from phdtrack.errors import InputError
from phdtrack.files import cannot_write, json_value, part_of, publish, whole
from phdtrack.run.directory import DETECTED, KNOWN, LOG, RunDirectory
from phdtrack.run.inputs import Detected, Inputs, Mover, detected, learn_scene
from phdtrack.state import blocks, from_bytes, to_bytes
from phdtrack.types import STILL, Detections, Frame

EVERY = 10.0
"""Seconds between two checkpoints, where nothing else is said."""
# Of the files: it changes with them, and with what a detector finds.
FORMAT = 5
Key = Mapping[str, object]
# Bytes that a detector's knowledge may have: several times that of pictures of 8192x4320.
_LARGEST = 1 << 32
# What comes of values that are of other types.
_NONE = (LookupError, ArithmeticError, TypeError, ValueError, AttributeError, RecursionError)


@dataclass(frozen=True, slots=True)
class Known:
    """What a detector knew after frame ``number``, where the log of frames up to it is ``size``
    bytes long.
    """

    number: int
    size: int
    detector: dict[str, Any]


class Checkpoint:
    """The checkpoint of a run. Raises `InputError` where what is there cannot be read, or belongs
    to a run of other inputs or settings.

    Parameters
    ----------
    directory : of the run.
    key, looked : what decides the result, and what the detections, in values that JSON knows;
        empty: not known.
    every : seconds between two times that it is brought to disk.
    resume : go on from what is there; without anything there it is a run from the beginning.
    anew : do not take what an earlier run has detected.
    """

    def __init__(
        self,
        directory: RunDirectory,
        key: Key,
        looked: Key,
        every: float,
        *,
        resume: bool,
        anew: bool = False,
    ) -> None:
        self._log, self._known, self._kept = (
            directory.file(name) for name in (LOG, KNOWN, DETECTED)
        )
        self._key = _text(key)
        self._looked = _text(looked)
        self._every = every
        self._due = 0.0
        self._saving: threading.Thread | None = None
        # Why there are no more checkpoints; empty where there are.
        self.problem = ""
        self.known = self._read() if resume and self._known.exists() else None
        self.reused = bool(
            looked and not anew and self.known is None and self._kept_first() == self._looked
        )

    @property
    def number(self) -> int:
        """The frame from which on is detected; 0 where that is the first."""
        if self.known:
            return self.known.number + 1
        return 0

    def detected(
        self, inputs: Inputs, frames: Iterable[Frame], mover: Mover | None
    ) -> Iterator[Detected]:
        """As `inputs.detected`; frames before the checkpoint come out of the log, and all others go
        into it.
        """
        iterator = iter(frames)
        known = self.known
        if self.reused:
            yield from self._reused(iterator, mover)
            return
        learn_scene(inputs)
        if known is not None:
            yield from self._again(inputs, iterator, mover, known)
        with self._log.open("r+b" if known else "wb", buffering=0) as log:
            if known:
                log.truncate(known.size)
                log.seek(known.size)
            self._due = time.monotonic() + self._every
            if not known:
                self._add(inputs, {"looked": self._looked}, log)
            one = None
            try:
                for one in detected(inputs.detector, iterator, mover):
                    self._add(inputs, _plain(one), log)
                    yield one
            except GeneratorExit:
                # The run was stopped, and is to go on from here.
                if one is not None and not self.problem:
                    self._due = 0.0
                    with suppress(OSError):
                        self._save(inputs, one.frame.number, log)
                raise
            finally:
                if self._saving is not None:
                    self._saving.join()
        if self._looked and not self.problem and not inputs.source.problem:
            # All frames were looked at, and a run that is resumed takes them from there.
            with suppress(OSError):
                self._log.replace(part_of(self._kept))
                publish(self._kept)
                self._known.unlink(missing_ok=True)

    def _reused(self, frames: Iterator[Frame], mover: Mover | None) -> Iterator[Detected]:
        """What an earlier run has detected in these frames."""
        with self._kept.open("rb") as log:
            stored = blocks(log)
            next(stored)
            for frame in frames:
                one = _made(next(stored, (0, None))[1], frame, self._kept, "Say --detect-again")
                # How the camera moved may be wanted otherwise than then.
                yield one._replace(
                    warp=STILL if mover is None else mover(frame, one.found, one.pose)
                )

    def _kept_first(self) -> str:
        """What decided the detections that an earlier run has left; empty where there are none."""
        with suppress(OSError, KeyError, TypeError, StopIteration), self._kept.open("rb") as log:
            return str(next(blocks(log))[1]["looked"])
        return ""

    def _again(
        self, inputs: Inputs, frames: Iterator[Frame], mover: Mover | None, known: Known
    ) -> Iterator[Detected]:
        """What the log holds, up to the frame that the detector's knowledge is of; the detector
        knows it then.
        """
        with self._log.open("rb") as log:
            stored = blocks(log)
            pose = STILL
            next(stored, None)
            for (end, plain), frame in zip(stored, frames, strict=False):
                one = _made(plain, frame, self._log)
                pose = one.pose if len(one.pose) else pose
                if end == known.size:
                    if one.frame.number != known.number:
                        break
                    restore(inputs.detector, known.detector, frame)
                    if mover is not None:
                        # It knows the picture before.
                        mover(frame, one.found, pose)
                    yield one
                    return
                yield one
        raise InputError(
            "it ends before the checkpoint", where=self._log, cure="Say --overwrite to begin anew."
        )

    def _add(self, inputs: Inputs, block: dict[str, Any], log: BinaryIO) -> None:
        """Write a block, of a frame or the first. Where that fails there are no more checkpoints,
        and the run goes on.
        """
        if self.problem:
            return
        try:
            # It is to outlast the process. What a power cut takes is what came since the last
            # checkpoint.
            left = memoryview(to_bytes(block))
            while left:
                # On a disk that is nearly full a part of it is taken.
                left = left[log.write(left) :]
            if "number" in block:
                self._save(inputs, block["number"], log)
        except OSError as error:
            self.problem = (
                f"no checkpoints from frame {block.get('number', 1)} on:"
                f" {cannot_write(self._log, error)}"
            )

    def _save(self, inputs: Inputs, number: int, log: BinaryIO) -> None:
        """Bring everything to disk, by a thread of its own, if it is time and the last time has
        ended.
        """
        if time.monotonic() < self._due or (self._saving is not None and self._saving.is_alive()):
            return
        self._due = time.monotonic() + self._every
        known = knowledge(inputs.detector)
        if known is None:
            return
        value = {
            "format": FORMAT,
            "key": self._key,
            "number": number,
            "size": log.tell(),
            "detector": known,
        }
        block = to_bytes(value)
        descriptor = os.dup(log.fileno())

        def save() -> None:
            try:
                os.fsync(descriptor)
                with whole(self._known) as part:
                    part.write_bytes(zlib.compress(block, 1))
            except (InputError, OSError):
                # The disk is full, or the folder is gone: the run will find that out by itself.
                pass
            finally:
                os.close(descriptor)

        self._saving = threading.Thread(target=save, name="phdtrack checkpoint")
        self._saving.start()

    def _read(self) -> Known:
        """The detector's knowledge. Raises `InputError` where it is none, or that of another
        run.
        """
        where = self._known
        cure = "Say --overwrite to begin anew."
        try:
            value = from_bytes(zlib.decompressobj().decompress(where.read_bytes(), _LARGEST), where)
            form, key, number, size = (value[name] for name in ("format", "key", "number", "size"))
            known = Known(int(number), int(size), dict(value["detector"]))
            before = dict(json.loads(key))
            other = not isinstance(form, int) or form != FORMAT
        except (InputError, OSError, zlib.error, *_NONE) as error:
            raise InputError(
                f"no checkpoint can be read from it ({error})", where=where, cure=cure
            ) from None
        if other:
            raise InputError(
                "this checkpoint is of another version of phdtrack", where=where, cure=cure
            )
        if key != self._key:
            now = json.loads(self._key)
            different = sorted(
                name for name in before.keys() | now.keys() if before.get(name) != now.get(name)
            )
            problem = f"this checkpoint is of a run that differs in: {', '.join(different)}"
            raise InputError(
                problem, where=where, cure=f"Give the same, or choose another --out. {cure}"
            )
        return known


def source_of(path: str) -> list[object]:
    """What shows whether a file has changed: its name, size and time; of a folder those of what is
    in it.
    """
    file = Path(path)
    if file.is_dir():
        return [
            path,
            sorted(
                (one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in file.iterdir()
            ),
        ]
    if file.exists():
        return [path, file.stat().st_size, file.stat().st_mtime_ns]
    return [path]


def _text(key: Key) -> str:
    """What decides a result, as text; empty for nothing."""
    if not key:
        return ""
    return json.dumps(json_value({"version": __version__, "format": FORMAT, **key}), sort_keys=True)


def _plain(one: Detected) -> dict[str, Any]:
    """What a block of the log holds."""
    found = one.found
    arrays = {"xyxy": found.xyxy, "confidence": found.confidence, "class_id": found.class_id}
    if found.covariance is None:
        more = {}
    else:
        more = {"covariance": found.covariance}
    state = {
        "number": one.frame.number,
        "time": one.frame.time,
        "observed": found.observed,
        "seconds": one.seconds,
    }
    return {**arrays, **more, **state, "warp": one.warp, "pose": one.pose}


def _made(
    plain: Any, frame: Frame, where: Path, cure: str = "Say --overwrite to begin anew."
) -> Detected:
    """What a block of the log says of the frame. Raises `InputError` where it is of another frame,
    or no such block.
    """
    try:
        same = plain["number"] == frame.number and plain["time"] == frame.time
        warp = plain["warp"]
        pose = plain["pose"]
        seconds = float(plain["seconds"])
        observed = bool(plain["observed"])
        found = Detections(
            plain["xyxy"], plain["confidence"], plain["class_id"], plain.get("covariance"), observed
        )
        maps = all(
            one.dtype == np.float64 and one.shape in ((3, 3), STILL.shape) for one in (warp, pose)
        )
        # A camera that shakes hardly zooms; of a damaged pose there may be no inverse.
        likely = bool(np.isfinite(pose).all()) and (
            not len(pose) or 0.5 < np.linalg.det(pose) < 2.0
        )
        good = same and _sound(found) and maps and likely
    except _NONE:
        good = False
    if not good:
        problem = f"what it says of frame {frame.number} does not fit the source"
        raise InputError(problem, where=where, cure=cure)
    return Detected(frame, found, warp, seconds, pose)


def _sound(found: Detections) -> bool:
    """Whether the arrays are of the types and shapes of detections, and boxes finite."""
    n = len(found)
    covariance = found.covariance
    arrays = [(found.xyxy, (n, 4)), (found.confidence, (n,))] + (
        [] if covariance is None else [(covariance, (n, 4, 4))]
    )
    finite = all(
        a.dtype == np.float64 and a.shape == shape and np.isfinite(a).all() for a, shape in arrays
    )
    return finite and found.class_id.dtype == np.int64 and found.class_id.shape == (n,)
