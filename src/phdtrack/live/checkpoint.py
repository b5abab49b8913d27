"""What a camera knows, on disk every few seconds: after a restart its tracks and counts go on.

``checkpoint.state`` in the folder of the camera holds the tracker, who is where, the counts, also
of each minute, the maps, and frames whose rows are still to come. Groups are found anew and get new
numbers: no event says that the old ones vanished. The next run takes it up where its source shows
pictures of the same size, and settings that decide what a state means are the same. Its time goes
on by the clock, and its frame numbers after the last one.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack import __version__
from phdtrack.errors import InputError
from phdtrack.files import json_value, whole
from phdtrack.live.events import WatchState
from phdtrack.live.zones import Place
from phdtrack.state import World, from_bytes, pack, restored, to_bytes
from phdtrack.types import F8

NAME = "checkpoint.state"
EVERY = 10.0
"""The file, and the seconds between two of them where nothing else is said."""
# Identities that a run which was killed may have given since; bytes of what a file may hold.
LOST = 1000
_LARGEST = 1 << 30


class HeldFrame(NamedTuple):
    """A frame whose rows are still to come: number, seconds, seconds since 1970, and boxes (N,
    4).
    """

    number: int
    time: float
    wall: float
    xyxy: F8


class SavedWatch(NamedTuple):
    """Lines and zones, who is there, and the counts. It is saved with each event, so that none
    comes twice or is missing.
    """

    places: tuple[Place, ...]
    state: WatchState

    def content(self) -> bytes:
        """For `EventLog.write`."""
        return to_bytes({"watch": pack(self)})

    @classmethod
    def read(cls, content: bytes, where: Path) -> SavedWatch:
        """What `content` gave. Raises `InputError` where it is damaged."""
        found: SavedWatch = restored(
            from_bytes(content, where)["watch"], cls, None, World(None, {}), str(where)
        )
        return found


class SavedCamera(NamedTuple):
    """What a camera knows besides its tracker.

    Attributes
    ----------
    number, time, wall : of the last frame, seconds, and since 1970.
    places, watch : lines and zones, who is there and the counts.
    held : frames whose rows are still to come.
    people, clutter, mapped : the maps (h, w), and the time that they are of.
    minutes : (n, 4) of each minute its beginning, mean and largest count, and frames.
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
    """What must be the same for a checkpoint to be taken up.

    Parameters
    ----------
    fixed : settings that cannot change while it runs, by name.
    width, height : of the pictures.
    """
    what = {"version": __version__, "width": width, "height": height, "settings": fixed}
    return json.dumps(json_value(what), sort_keys=True)


def save(
    folder: Path,
    key: str,
    tracker: Callable[[], dict[str, Any]],
    camera: SavedCamera,
    highest: int,
    *,
    ended: bool,
) -> None:
    """Write the checkpoint, whole or not at all. Raises `InputError` where it cannot be written.

    Parameters
    ----------
    folder : of the camera.
    key : from `key_of`.
    tracker : gives its state, from `Tracker.snapshot`.
    camera : all else.
    highest : the highest identity that was given.
    ended : no further one will be given by this run.
    """
    value = {"key": key, "highest": highest + (0 if ended else LOST), "ended": ended}
    content = zlib.compress(to_bytes(value | {"tracker": tracker(), "camera": pack(camera)}), 1)
    with whole(folder / NAME) as part:
        part.write_bytes(content)


def load(folder: Path, key: str) -> tuple[int, bool, Any, SavedCamera | InputError] | None:
    """The lowest identity less 1 that may be given, whether the run had ended, the tracker's state,
    and all else.

    None where there is no checkpoint. The last is an `InputError` where it is of other settings.
    Raises `InputError` where it is damaged, `OSError` where it cannot be read now.
    """
    path = folder / NAME
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    try:
        value = from_bytes(zlib.decompressobj().decompress(content, _LARGEST), path)
        words, highest, ended, tracker, camera = (
            value[n] for n in ("key", "highest", "ended", "tracker", "camera")
        )
        if not isinstance(words, str) or type(highest) is not int or not 0 <= highest < 1 << 52:
            raise ValueError
        before = json.loads(words)
        now = json.loads(key)
        other = [name for name in now if before.get(name) != now[name]]
    except (zlib.error, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError("it is cut off or changed", where=path) from error
    if other:
        return highest, True, None, InputError(f"it differs in: {', '.join(other)}", where=path)
    return (
        highest,
        bool(ended),
        tracker,
        restored(camera, SavedCamera, None, World(None, {}), str(path)),
    )
