"""The log of detections: how an interrupted run is resumed, and why the next one need not detect
again.

Detection takes most of a run's time. So a checkpoint holds no state of the tracker:
``checkpoint.log`` holds the detections of every frame, bit for bit, and ``checkpoint.detector`` the
detector's knowledge after one of these frames. A resumed run tracks the frames up to that one
again, from the log, and detects from there on. The same code writes the same numbers as in a run
that was never interrupted.

After the last frame the log becomes ``detections.cache``. Its first block holds what decided it:
the file, the detector, its settings, and the code that reads and detects. A run in which these are
the same reads its detections from there.
"""

from __future__ import annotations

import json
import os
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from phdtrack import __version__
from phdtrack.arrays import half_if_exact
from phdtrack.detect import knowledge, restore
from phdtrack.detect.base import described, prepared
from phdtrack.errors import InputError
from phdtrack.files import cannot_write, json_value, part_of, publish, whole
from phdtrack.run.camera_motion import Mover
from phdtrack.run.directory import DETECTED, KNOWN, LOG, RunDirectory
from phdtrack.run.inputs import Inputs, Watch, study_scene, unwatched
from phdtrack.run.loop import NO_PICTURE, DetectedFrame, detect_frames
from phdtrack.run.pipeline_threads import ahead
from phdtrack.state import blocks, from_bytes, to_bytes
from phdtrack.types import STILL, Detections, Frame

# Of the files: it changes with them.
FORMAT = 5
Key = Mapping[str, object]
# Bytes that a detector's knowledge may have: several times that of pictures of 8192x4320.
_LARGEST = 1 << 32
# Errors that values of other types raise.
_NONE = (LookupError, ArithmeticError, TypeError, ValueError, AttributeError, RecursionError)
_BEGIN_ANEW = "Say --overwrite to begin anew."


@dataclass(frozen=True, slots=True)
class DetectorCheckpoint:
    """A detector's knowledge after frame ``number``; the log of frames up to it is ``size`` bytes
    long.
    """

    number: int
    size: int
    knowledge: dict[str, Any]


class DetectionLog:
    """The log of a run. Raises `InputError` if an earlier one cannot be read, or belongs to a run
    of other inputs or settings.

    Parameters
    ----------
    directory : of the run.
    key, detected_by : what decides the result, and what the detections, in values that JSON knows;
        empty: not known.
    every : seconds between checkpoints.
    resume : continue from the checkpoint, if there is one.
    anew : do not reuse detections of an earlier run.
    described_by : what decides their embeddings, in values that JSON knows; None without any. Those
        that were decided by something else are described anew.
    """

    def __init__(
        self,
        directory: RunDirectory,
        key: Key,
        detected_by: Key,
        every: float,
        *,
        resume: bool,
        anew: bool = False,
        described_by: object = None,
    ) -> None:
        self._log = directory.file(LOG)
        self._checkpoint = directory.file(KNOWN)
        self._complete = directory.file(DETECTED)
        self._key = _text(key)
        self._detected_by = _text(detected_by)
        self._described_by = ""
        if described_by is not None:
            self._described_by = json.dumps(json_value(described_by), sort_keys=True)
        self._every = every
        self._due = 0.0
        self._saving: threading.Thread | None = None
        # Why there are no more checkpoints; empty while there are.
        self.problem = ""
        self.checkpoint: DetectorCheckpoint | None = None
        if resume and self._checkpoint.exists():
            self.checkpoint = self._read()
        self.reused = bool(
            detected_by
            and not anew
            and self.checkpoint is None
            and self._decided_by()[0] == self._detected_by
        )

    @property
    def number(self) -> int:
        """The first frame to detect in; 0 if that is the first of all."""
        if self.checkpoint:
            return self.checkpoint.number + 1
        return 0

    @contextmanager
    def detected_frames(
        self, inputs: Inputs, mover: Mover | None = None, watch: Watch = unwatched
    ) -> Iterator[Iterator[DetectedFrame]]:
        """Every frame with its detections, as `inputs.detected_frames`; those before the
        checkpoint, or all that an earlier run detected, are read from the log.

        Parameters
        ----------
        inputs : frames and detector.
        mover : the camera's motion; None for a camera that stands still.
        watch : as `study_scene` takes it.
        """
        source: Iterable[Frame] = inputs.source
        if not self.reused:
            source = prepared(inputs.detector, inputs.source)
        with (
            ahead(source) as pictures,
            ahead(self.detect(inputs, pictures, mover, watch)) as detected,
        ):
            yield detected

    def detect(
        self,
        inputs: Inputs,
        frames: Iterator[Frame],
        mover: Mover | None = None,
        watch: Watch = unwatched,
    ) -> Iterator[DetectedFrame]:
        """Each frame with its detections, from the log, or from the detector into the log.

        Parameters
        ----------
        inputs, frames : the detector, and the frames.
        mover : the camera's motion; None for a camera that stands still.
        watch : as `study_scene` takes it.
        """
        checkpoint = self.checkpoint
        if self.reused:
            yield from self._reused(inputs, frames, mover)
            return
        study_scene(inputs, watch)
        if checkpoint is not None:
            yield from self._logged(inputs, frames, mover, checkpoint)
        with self._log.open("r+b" if checkpoint else "wb", buffering=0) as log:
            if checkpoint:
                log.truncate(checkpoint.size)
                log.seek(checkpoint.size)
            self._due = time.monotonic() + self._every
            if not checkpoint:
                decided = {"looked": self._detected_by, "described": self._described_by}
                self._add(inputs, decided, log)
            detected = None
            try:
                describer = inputs.descriptors.describer
                for detected in detect_frames(inputs.detector, frames, mover, describer):
                    self._add(inputs, _block(detected), log)
                    yield detected
            except GeneratorExit:
                # The run was stopped, and is to be resumed from here.
                if detected is not None and not self.problem:
                    self._due = 0.0
                    with suppress(OSError):
                        self._save(inputs, detected.frame.number, log)
                raise
            finally:
                if self._saving is not None:
                    self._saving.join()
        if self._detected_by and not self.problem and not inputs.source.problem:
            # All frames are in the log, and a resumed run reads them from there.
            with suppress(OSError):
                self._log.replace(part_of(self._complete))
                publish(self._complete)
                self._checkpoint.unlink(missing_ok=True)

    def _reused(
        self, inputs: Inputs, frames: Iterator[Frame], mover: Mover | None
    ) -> Iterator[DetectedFrame]:
        """The detections of an earlier run in these frames."""
        same_looks = self._decided_by()[1] == self._described_by
        with self._complete.open("rb") as log:
            stored = blocks(log)
            next(stored)
            for frame in frames:
                block = next(stored, (0, None))[1]
                detected = _detected(block, frame, self._complete, "Say --detect-again")
                if not same_looks:
                    found = replace(detected.detections, embeddings=None)
                    found = described(found, frame, inputs.descriptors.describer)
                    detected = detected._replace(detections=found)
                # The camera's motion may be another one than then.
                warp = STILL
                if mover is not None:
                    warp = mover(frame, detected.detections, detected.pose)
                yield detected._replace(warp=warp)

    def _decided_by(self) -> tuple[str, str]:
        """The keys of the detections that an earlier run left, and of their embeddings; empty if
        there are none.
        """
        errors = (OSError, KeyError, TypeError, AttributeError, StopIteration)
        with suppress(*errors), self._complete.open("rb") as log:
            first = next(blocks(log))[1]
            return str(first["looked"]), str(first.get("described", ""))
        return "", ""

    def _logged(
        self,
        inputs: Inputs,
        frames: Iterator[Frame],
        mover: Mover | None,
        checkpoint: DetectorCheckpoint,
    ) -> Iterator[DetectedFrame]:
        """The logged detections up to the checkpoint; the detector then has its knowledge."""
        with self._log.open("rb") as log:
            stored = blocks(log)
            pose = STILL
            next(stored, None)
            for (end, block), frame in zip(stored, frames, strict=False):
                detected = _detected(block, frame, self._log, _BEGIN_ANEW)
                if len(detected.pose):
                    pose = detected.pose
                if end == checkpoint.size:
                    if detected.frame.number != checkpoint.number:
                        break
                    restore(inputs.detector, checkpoint.knowledge, frame)
                    if mover is not None:
                        # It needs the picture before the next one.
                        mover(frame, detected.detections, pose)
                    yield detected
                    return
                yield detected
        raise InputError("it ends before the checkpoint", where=self._log, cure=_BEGIN_ANEW)

    def _add(self, inputs: Inputs, block: dict[str, Any], log: BinaryIO) -> None:
        """Write a block. If that fails there are no more checkpoints, and the run goes on."""
        if self.problem:
            return
        try:
            # It is to outlast the process. A power cut takes what was written since the last
            # checkpoint.
            write_block(log, block)
            if "number" in block:
                self._save(inputs, block["number"], log)
        except OSError as error:
            self.problem = (
                f"no checkpoints from frame {block.get('number', 1)} on:"
                f" {cannot_write(self._log, error)}"
            )

    def _save(self, inputs: Inputs, number: int, log: BinaryIO) -> None:
        """Bring everything to disk, in a thread of its own, if it is time and the last time has
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
                with whole(self._checkpoint) as part:
                    part.write_bytes(zlib.compress(block, 1))
            except (InputError, OSError):
                # The disk is full, or the folder is gone: the run finds that out by itself.
                pass
            finally:
                os.close(descriptor)

        self._saving = threading.Thread(target=save, name="phdtrack checkpoint")
        self._saving.start()

    def _read(self) -> DetectorCheckpoint:
        """The checkpoint. Raises `InputError` if it is damaged, or that of another run."""
        where = self._checkpoint
        try:
            value = from_bytes(zlib.decompressobj().decompress(where.read_bytes(), _LARGEST), where)
            checkpoint = DetectorCheckpoint(
                int(value["number"]), int(value["size"]), dict(value["detector"])
            )
            key = value["key"]
            before = dict(json.loads(key))
            same_format = value["format"] == FORMAT
        except (InputError, OSError, zlib.error, *_NONE) as error:
            problem = f"no checkpoint can be read from it ({error})"
            raise InputError(problem, where=where, cure=_BEGIN_ANEW) from None
        if same_format is not True:
            problem = "this checkpoint is of another version of phdtrack"
            raise InputError(problem, where=where, cure=_BEGIN_ANEW)
        if key != self._key:
            now = json.loads(self._key)
            names = sorted(
                name for name in before.keys() | now.keys() if before.get(name) != now.get(name)
            )
            problem = f"this checkpoint is of a run that differs in: {', '.join(names)}"
            cure = f"Give the same, or choose another --out. {_BEGIN_ANEW}"
            raise InputError(problem, where=where, cure=cure)
        return checkpoint


def write_block(log: BinaryIO, block: dict[str, Any]) -> None:
    """Write a block to an unbuffered file; a disk that is nearly full takes it in parts."""
    left = memoryview(to_bytes(block))
    while left:
        left = left[log.write(left) :]


def save_detections(path: Path, frames: Iterable[DetectedFrame]) -> Iterator[DetectedFrame]:
    """Write the detections of each frame to a file, bit for bit, and give the frame."""
    with path.open("wb") as log:
        for detected in frames:
            log.write(to_bytes(_block(detected)))
            yield detected


def load_detections(path: Path) -> Iterator[DetectedFrame]:
    """The frames that `save_detections` wrote, without pictures. Raises `InputError` if the file is
    damaged.
    """
    with path.open("rb") as log:
        for _, block in blocks(log):
            frame = Frame(block["number"], block["time"], NO_PICTURE)
            yield _detected(block, frame, path, "Remove it, and run again.")


def source_of(path: str) -> list[object]:
    """Name, size and time of a file, which show whether it has changed; for a folder those of its
    files.
    """
    file = Path(path)
    if file.is_dir():
        files = [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in file.iterdir()]
        return [path, sorted(files)]
    if file.exists():
        return [path, file.stat().st_size, file.stat().st_mtime_ns]
    return [path]


def _text(key: Key) -> str:
    """The key as text; empty for an empty one."""
    if not key:
        return ""
    return json.dumps(json_value({"version": __version__, "format": FORMAT, **key}), sort_keys=True)


def _block(detected: DetectedFrame) -> dict[str, Any]:
    """The contents of a block of the log."""
    detections = detected.detections
    block = {
        "xyxy": detections.xyxy,
        "confidence": detections.confidence,
        "class_id": detections.class_id,
        "number": detected.frame.number,
        "time": detected.frame.time,
        "observed": detections.observed,
        "seconds": detected.seconds,
        "warp": detected.warp,
        "pose": detected.pose,
    }
    if detections.covariance is not None:
        block["covariance"] = detections.covariance
    if detections.embeddings is not None:
        block["embeddings"] = half_if_exact(detections.embeddings)
    return block


def _detected(block: Any, frame: Frame, where: Path, cure: str) -> DetectedFrame:
    """The detections in a block. Raises `InputError` if it is of another frame, or damaged."""
    try:
        same = block["number"] == frame.number and block["time"] == frame.time
        warp = block["warp"]
        pose = block["pose"]
        embeddings = block.get("embeddings")
        if embeddings is not None:
            embeddings = embeddings.astype(np.float32)
        detected = DetectedFrame(
            frame,
            Detections(
                block["xyxy"],
                block["confidence"],
                block["class_id"],
                covariance=block.get("covariance"),
                observed=bool(block["observed"]),
                embeddings=embeddings,
            ),
            warp,
            float(block["seconds"]),
            pose,
        )
        maps = all(
            one.dtype == np.float64 and one.shape in ((3, 3), STILL.shape) for one in (warp, pose)
        )
        # A camera that shakes hardly zooms; a damaged pose may have no inverse.
        likely = bool(np.isfinite(pose).all()) and (
            not len(pose) or 0.5 < np.linalg.det(pose) < 2.0
        )
        good = same and _sound(detected.detections) and maps and likely
    except _NONE:
        good = False
    if not good:
        problem = f"its entry for frame {frame.number} does not fit the source"
        raise InputError(problem, where=where, cure=cure)
    return detected


def _sound(detections: Detections) -> bool:
    """True if the arrays have the types and shapes of detections, and finite values."""
    n = len(detections)
    arrays = [(detections.xyxy, (n, 4)), (detections.confidence, (n,))]
    if detections.covariance is not None:
        arrays.append((detections.covariance, (n, 4, 4)))
    embeddings = detections.embeddings
    if embeddings is not None and (embeddings.ndim != 2 or len(embeddings) != n):
        return False
    finite = all(
        a.dtype == np.float64 and a.shape == shape and np.isfinite(a).all() for a, shape in arrays
    )
    label = detections.class_id
    return finite and label.dtype == np.int64 and label.shape == (n,)
