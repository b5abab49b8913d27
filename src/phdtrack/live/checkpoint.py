"""Checkpoints of a live camera, written every few seconds: after a restart its tracks and counts
continue.

``checkpoint.state`` in the folder of the camera holds the tracker, the visitors, the counts (also
per minute), the maps, and frames whose rows are still to come. Groups are found anew and get new
numbers; no event reports that the old ones ended. The next run uses the checkpoint if its pictures
have the same size and the settings that a state depends on are the same. Its time continues by the
clock, and its frame numbers after the last one.
"""

from __future__ import annotations

import json
import math
import threading
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack import __version__
from phdtrack.errors import InputError
from phdtrack.files import json_value, whole
from phdtrack.live.events import WatchState
from phdtrack.live.zones import Place
from phdtrack.state import from_bytes, to_bytes, unpack
from phdtrack.types import F8

NAME = "checkpoint.state"
"""The file's name."""
EVERY = 10.0
"""Default seconds between two checkpoints."""
# Identities that a killed run may have given after its last checkpoint.
LOST = 1000


class HeldFrame(NamedTuple):
    """A frame whose rows are still to come: number, seconds, seconds since 1970, and boxes (N,
    4).
    """

    number: int
    time: float
    wall: float
    xyxy: F8


class SavedWatch(NamedTuple):
    """Lines and zones, the visitors, and the counts. It is saved with each event, so that none is
    reported twice or lost.
    """

    places: tuple[Place, ...]
    state: WatchState

    def content(self) -> bytes:
        """The record as bytes, for `EventLog.write`."""
        return to_bytes(self)

    @classmethod
    def read(cls, content: bytes, where: Path) -> SavedWatch:
        """The record that `content` was made of. Raises `InputError` if it is damaged."""
        found: SavedWatch = unpack(from_bytes(content, where), cls, where=str(where))
        return found


class SavedCamera(NamedTuple):
    """Everything that a camera's checkpoint holds besides the tracker.

    Attributes
    ----------
    number, time, wall : of the last frame, seconds, and since 1970.
    places, watch : lines and zones, the visitors and the counts.
    held : frames whose rows are still to come.
    people, clutter, mapped : the maps (h, w), and the time of their last update.
    minutes : (n, 4) beginning, mean and largest count, and number of frames of each minute.
    """

    number: int
    time: float
    wall: float
    places: tuple[Place, ...]
    watch: WatchState
    held: tuple[HeldFrame, ...]
    people: F8
    clutter: F8
    mapped: float
    minutes: F8


def key_of(fixed: Mapping[str, object], width: int, height: int) -> str:
    """A text that must be the same for a checkpoint to be used.

    Parameters
    ----------
    fixed : settings that cannot change while it runs, by name.
    width, height : of the pictures.
    """
    document = {"version": __version__, "width": width, "height": height, "settings": fixed}
    return json.dumps(json_value(document), sort_keys=True)


def load(folder: Path, key: str) -> tuple[int, bool, Any, SavedCamera | InputError] | None:
    """The highest identity that may have been given, whether the run had ended, the tracker's
    state, and everything else; None if there is no checkpoint.

    The last is an `InputError` if the checkpoint is of other settings.

    Raises
    ------
    InputError : the checkpoint is damaged or of another format.
    OSError : it cannot be read now.
    """
    path = folder / NAME
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    decompressor = zlib.decompressobj()
    try:
        block = decompressor.decompress(content)
    except zlib.error as error:
        raise InputError("it is cut off or changed", where=path) from error
    if not decompressor.eof:
        raise InputError("it is cut off or changed", where=path)
    value = from_bytes(block + decompressor.unused_data, path)
    before = json.loads(value["key"])
    now = json.loads(key)
    other = [name for name in now if before.get(name) != now[name]]
    if other:
        problem = InputError(f"it differs in: {', '.join(other)}", where=path)
        return value["highest"], True, None, problem
    camera: SavedCamera = unpack(value["camera"], SavedCamera, where=str(path))
    return value["highest"], value["ended"], value["tracker"], camera


class Checkpoints:
    """The checkpoints of a camera at work; ``problem`` says why the last one could not be written.

    Parameters
    ----------
    folder : of the camera.
    every : seconds between two; 0 for none.
    clock : seconds that only grow.
    """

    def __init__(
        self, folder: Path, every: float = EVERY, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._every = every
        self._clock = clock
        self._next = -math.inf
        self._writing = threading.Thread()
        self.problem = ""

    @property
    def due(self) -> bool:
        """True if one is to be written now."""
        passed = self._every > 0 and self._clock() >= self._next
        return passed and not self._writing.is_alive()

    def postpone(self) -> None:
        """Put the next one off by the usual time."""
        self._next = self._clock() + self._every

    def write_beside(self, *state: Any) -> None:
        """`write` it in a thread of its own; the next one is postponed."""
        self.postpone()
        self._writing = threading.Thread(
            target=self.write, args=state, name=f"checkpoint {self._folder}", daemon=True
        )
        self._writing.start()

    def write(
        self,
        key: str,
        tracker: Callable[[], dict[str, Any]],
        camera: SavedCamera,
        highest: int,
        *,
        ended: bool = False,
    ) -> None:
        """Write one now, whole or not at all; `problem` says why if that fails.

        Parameters
        ----------
        key : from `key_of`.
        tracker : returns its state, from `Tracker.snapshot`.
        camera : everything else.
        highest : the highest identity that was given.
        ended : this run gives no further identity.
        """
        try:
            value = {
                "key": key,
                "highest": highest + (0 if ended else LOST),
                "ended": ended,
                "tracker": tracker(),
                "camera": camera,
            }
            content = zlib.compress(to_bytes(value), 1)
            with whole(self._folder / NAME) as part:
                part.write_bytes(content)
            self.problem = ""
        except Exception as error:
            self.problem = f"there is no newer checkpoint: {error}"

    def wait(self) -> None:
        """Wait for the one that is being written."""
        if self._writing.ident is not None:
            self._writing.join()
