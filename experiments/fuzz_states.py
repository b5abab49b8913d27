"""Broken saved states: ``python -m experiments.fuzz_states [states|track|live] --inputs N
[--minutes M] [--out FILE.json]``.

Every filter tracks a few frames of several targets and clutter, some with classes, with what is
learned, a delay, a camera that moves. What is saved is changed: arrays are shorter, longer, of
another type or shape, their values NaN, infinite, huge, negative or out of range; records change
places, keys are missing. It is loaded, and where it is accepted, three updates and `tracks` follow.
Checkpoint files are changed byte by byte, with checksums that are right again, and read. So it is
with what `phdtrack track` resumes from (``track``: checkpoint.log and checkpoint.detector, whose
frames then go through a tracker) and a camera of `phdtrack live` (``live``: checkpoint.state, with
three more frames). All else is as in `experiments.fuzz`.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import os
import pickle
import random
import struct
import tempfile
import time
import warnings
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from experiments.fuzz import ROOT, Limits, Report, _shared, campaign
from phdtrack import Tracker
from phdtrack.config import build_classes, load
from phdtrack.detect import make_detector
from phdtrack.errors import InputError
from phdtrack.live.checkpoint import NAME as STATE
from phdtrack.live.engine import Camera, CameraSettings, Making
from phdtrack.live.events import Watch
from phdtrack.live.live_page import Page
from phdtrack.live.zones import Place
from phdtrack.run.detection_log import Checkpoint
from phdtrack.run.directory import KNOWN, LOG
from phdtrack.state import blocks, from_bytes, to_bytes
from phdtrack.types import Detections, Frame, SequenceInfo
from phdtrack.video.live_sources import LiveFrame, SourceStatus

FRAMES = 6
SIZE = (640, 480)
# Inputs of one seed.
CHUNK = 250
_FEW = {"particles_per_target": 30}
_GRAPH = {"associate": {"kind": "graph"}}
SETTINGS: dict[str, dict[str, Any]] = {
    "pmb": {},
    "pmb delay": {"associate": {"output_delay": 2}},
    "pmb classes": {"classes": {"together": [[2, 7]]}},
    "pmb graph": {**_GRAPH, "extract": {"min_weight": 0.3}},
    "pmb slow": {"time": {"longest_interval": 0.01}},
    "pmb merged": {"merged_measurements": {"kind": "explained"}},
    "pmbm": {"filter": {"kind": "pmbm"}},
    "pmbm graph": {"filter": {"kind": "pmbm"}, **_GRAPH},
    "mht": {"filter": {"kind": "mht", "history": 3}, "associate": {"output_delay": 2}},
    "gm-phd": {"filter": {"kind": "gm-phd"}},
    "gm-phd delay": {"filter": {"kind": "gm-phd"}, "associate": {"output_delay": 2}},
    "gm-cphd": {"filter": {"kind": "gm-cphd"}},
    "particle-phd": {"filter": {"kind": "particle-phd", **_FEW}, "birth": {"particles": 30}},
    "particle-cphd": {"filter": {"kind": "particle-cphd", **_FEW}, "birth": {"particles": 30}},
    "mcmc": {"filter": {"kind": "mcmc", "samples": 12, "burn_in": 4}},
    "none": {"filter": {"kind": "none"}},
    "d14": {"preset": "d14", "filter": {"particles_per_target": 50, "max_particles": 100}},
}
MOVED = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])


def frame(k: int, rng: np.random.Generator, *, classes: bool) -> Detections:
    """Four who walk, one false alarm, scores and, if asked, three classes."""
    boxes = [
        [
            60 + 150.0 * j + 3 * k * (-1) ** j,
            100 + 40.0 * j,
            100 + 150.0 * j + 3 * k * (-1) ** j,
            200 + 40.0 * j,
        ]
        for j in range(4)
    ]
    found = np.array([*boxes, [rng.uniform(0, 500), rng.uniform(0, 350), 0, 0]]) + rng.normal(
        0, 1, (5, 4)
    )
    found[4, 2:] = found[4, :2] + rng.uniform(30, 80, 2)
    return Detections(found, rng.uniform(0.4, 0.95, 5), np.array([2, 7, 2, 1, 7]) * classes)


def tracker_of(name: str) -> Tracker:
    """Before the first frame."""
    return Tracker(SIZE, seed=1, **SETTINGS[name])


def saved_of(name: str, frames: int = FRAMES) -> dict[str, Any]:
    """The state after some frames."""
    tracker = tracker_of(name)
    rng = np.random.default_rng(3)
    for k in range(frames):
        tracker.update(
            frame(k, rng, classes="classes" in name), warp=MOVED if name == "pmb" and k else None
        )
    return tracker.state_dict()


def go_on(tracker: Tracker, name: str) -> None:
    """Three updates and what comes of them."""
    rng = np.random.default_rng(4)
    at = tracker.state.number
    begun = tracker.state.time
    for k in range(1, 4):
        tracker.update(frame(at % 20 + k, rng, classes="classes" in name), at + k, begun + 0.04 * k)
    tracker.flush()
    tracker.tracks()


# ----------------------------------------------------------------------------------------------------------
# mutations

FLOATS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e18, -1.0, 0.0, 5e-324, 2.0, 1e9, -1e-9)
INTEGERS = (-1, -2, -3, 0, 1, 2, 7, 100, 1 << 31, (1 << 63) - 1, -(1 << 63), 1_000_000)
ODD = (
    None,
    True,
    "",
    "dict",
    [],
    {},
    -1,
    0,
    1,
    2,
    1 << 40,
    10**400,
    0.5,
    float("nan"),
    float("inf"),
    1e300,
    [[]],
    {"record": "dict"},
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The ways to every value within."""
    inside = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    found = [path] if path else []
    for key, one in inside:
        found += places(one, (*path, key))
    return found


def _at(value: Any, path: Sequence[Any]) -> Any:
    for key in path:
        value = value[key]
    return value


def _array(a: np.ndarray, rng: random.Random) -> Any:
    """Another array, or one of its values another."""
    what = rng.randrange(12)
    if what < 5 and a.size:
        b = a.copy()
        at = rng.randrange(a.size)
        flat = b.reshape(-1)
        if b.dtype.names:
            column = rng.choice(b.dtype.names)
            flat[column][at] = rng.choice(FLOATS if b.dtype[column].kind == "f" else INTEGERS)
        elif b.dtype.kind == "f":
            with np.errstate(all="ignore"):
                flat[at] = rng.choice((*FLOATS, float(flat[at]) * rng.choice((-1, 0.5, 3, 1e6))))
        else:
            near = int(flat[at]) + rng.choice((-1, 1, 2, 5))
            flat[at] = (
                rng.choice((*INTEGERS, near, near, near)) if b.dtype.kind == "i" else not flat[at]
            )
        return b
    if what == 5 and a.ndim:
        return a[: rng.randrange(len(a) + 1)]
    if what == 6 and a.ndim:
        return np.concatenate([a, a[:1]])
    if what == 7 and a.ndim > 1:
        return a[:, : rng.randrange(a.shape[1] + 1)]
    if what == 8 and not a.dtype.names:
        with np.errstate(all="ignore"):
            return a.astype(rng.choice(("f4", ">f8", "i4", "u8", "?", "f8", "i8")))
    if what == 9:
        return a.reshape(rng.choice(((-1,), (1, *a.shape), (*a.shape, 1))))
    if what == 10 and a.ndim:
        return a[::-1]
    return (
        a.T
        if what == 11
        else rng.choice((np.zeros(0), np.zeros((0, 0)), np.zeros(3, np.int64), np.array(3.0)))
    )


def changed(value: Any, rng: random.Random) -> Any:
    """What stands in a place of a state: another value."""
    if isinstance(value, np.ndarray) and rng.random() < 0.95:
        return _array(value, rng)
    if isinstance(value, bool):
        return rng.choice((not value, *ODD))
    if isinstance(value, (int, float)) and rng.random() < 0.9:
        return rng.choice(
            (
                value + rng.choice((-1, 1, 5)),
                -value,
                value * 1000,
                *(FLOATS if isinstance(value, float) else INTEGERS),
            )
        )
    if isinstance(value, list) and value and rng.random() < 0.9:
        k = rng.randrange(len(value))
        j = rng.randrange(len(value))
        swapped = list(value)
        swapped[k] = value[j]
        swapped[j] = value[k]
        return rng.choice(
            (value[:k] + value[k + 1 :], [*value, value[k]], value[:k], swapped, value[::-1], [])
        )
    if isinstance(value, dict) and value and rng.random() < 0.8:
        key = rng.choice(list(value))
        return (
            {k: v for k, v in value.items() if k != key}
            if rng.random() < 0.5
            else value | {key: rng.choice(ODD)}
        )
    return rng.choice(ODD)


def with_change(
    state: dict[str, Any], ways: list[tuple[Any, ...]], rng: random.Random
) -> dict[str, Any]:
    """A copy of the state in which one place is another; the same where a change before has taken
    that place away.
    """
    way = rng.choice(ways)
    try:
        new = changed(_at(state, way), rng)
        if rng.random() < 0.1:
            new = copy.deepcopy(_at(state, rng.choice(ways)))
        out: dict[str, Any] = _put(state, way, new)
        return out
    except (KeyError, IndexError, TypeError, OverflowError, ValueError):
        return state


def flipped(content: bytes, rng: random.Random) -> bytes:
    """A changed block, most of them with a checksum that is right."""
    block = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = (
            rng.randrange(8, len(block))
            if rng.random() < 0.5
            else 12 + min(int(rng.expovariate(1e-3)), len(block) - 13)
        )
        block[at] = rng.choice((0, 255, block[at] ^ (1 << rng.randrange(8)), *b'0123456789",:[]{}'))
    if rng.random() < 0.1:
        del block[rng.randrange(len(block)) :]
    if rng.random() < 0.9 and len(block) > 12:
        held = bytes(block[8:])
        block[:8] = struct.pack("<II", len(held), zlib.crc32(held))
    return bytes(block)


class States:
    """Makes and tries changed states."""

    def __init__(self) -> None:
        self.saved = {name: saved_of(name) for name in SETTINGS}
        self.begun = {name: saved_of(name, 0) for name in SETTINGS}
        self.ways = {name: places(one) for name, one in self.saved.items()}
        self.trackers = {name: tracker_of(name) for name in SETTINGS}
        self.names = list(SETTINGS)
        for name, one in self.saved.items():
            for state in (one, self.begun[name], from_bytes(to_bytes(one))):
                self.trackers[name].load_state_dict(state)
                go_on(self.trackers[name], name)

    def make(self, rng: random.Random) -> bytes:
        """The number of the settings, and a changed state; one in four is the bytes of a
        checkpoint.
        """
        which = rng.randrange(len(self.names))
        name = self.names[which]
        if rng.random() < 0.25:
            return bytes((which, 1)) + flipped(to_bytes(self.saved[name]), rng)
        # Only what is changed is copied.
        state = dict(self.saved[name])
        for _ in range(rng.choice((1, 1, 1, 1, 2, 3))):
            state = with_change(state, self.ways[name], rng)
        return bytes((which, 0)) + pickle.dumps(state)

    def try_one(self, content: bytes) -> None:
        """Load it and go on."""
        warnings.simplefilter("ignore")
        name = self.names[content[0]]
        saved = from_bytes(content[2:]) if content[1] else pickle.loads(content[2:])
        tracker = self.trackers[name]
        tracker.load_state_dict(saved)
        go_on(tracker, name)


class Resumed:
    """Makes and tries changed files of a run that is resumed."""

    last = 8

    def __init__(self) -> None:
        self.frames = [Frame(k, k / 25, self.picture(k)) for k in range(1, self.last + 1)]
        detector = make_detector("change", min_area=0.005)
        self.inputs: Any = SimpleNamespace(detector=detector, pictures=True, again=False)
        self.folder = SimpleNamespace(
            file=lambda name: _shared() / f"phdtrack-fuzz-{os.getpid()}.{name}"
        )
        checkpoint = self.checkpoint(0.0, resume=False)
        for _ in checkpoint.detected(self.inputs, self.frames[:5], None):
            checkpoint._saving and checkpoint._saving.join()
        known, log = (self.folder.file(name) for name in (KNOWN, LOG))
        held: dict[str, Any] = {"known": from_bytes(zlib.decompress(known.read_bytes()))}
        with log.open("rb") as file:
            self.saved = held | {"log": [one for _, one in blocks(file)]}
        self.ways = places(self.saved)
        self.try_one(pickle.dumps((known.read_bytes(), log.read_bytes())))

    def checkpoint(self, every: float, *, resume: bool) -> Checkpoint:
        """That of the files of this process."""
        return Checkpoint(self.folder, {"source": "pictures"}, {}, every, resume=resume)  # type: ignore[arg-type]

    @staticmethod
    def picture(k: int) -> np.ndarray:
        """A white square that goes to the right."""
        image = np.full((60, 80, 3), 30, np.uint8)
        image[20:40, 4 * k : 4 * k + 12] = 255
        return image

    def make(self, rng: random.Random) -> bytes:
        """Both files, one or both of them changed."""
        state = dict(self.saved)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            state = with_change(state, self.ways, rng)
        known = state.get("known")
        log = state.get("log")
        parts = [
            block_of(one, self.saved["log"][0]) for one in (log if isinstance(log, list) else [])
        ]
        if parts and rng.random() < 0.2:
            k = rng.randrange(len(parts))
            parts[k] = flipped(parts[k], rng)
        if isinstance(known, dict) and rng.random() < 0.7:
            known = known | {
                "size": sum(map(len, parts)),
                "number": rng.choice((len(parts), known.get("number"))),
            }
        block = block_of(known, self.saved["known"])
        return pickle.dumps(
            (
                zlib.compress(flipped(block, rng) if rng.random() < 0.1 else block, 1),
                b"".join(parts),
            )
        )

    def try_one(self, content: bytes) -> None:
        """Resume, and track what comes of it."""
        warnings.simplefilter("ignore")
        for name, held in zip((KNOWN, LOG), pickle.loads(content), strict=True):
            self.folder.file(name).write_bytes(held)
        tracker = Tracker((80, 60))
        for one in self.checkpoint(1e9, resume=True).detected(self.inputs, self.frames, None):
            tracker.update(
                one.found, one.frame.number, one.frame.time, one.warp if len(one.warp) else None
            )
        tracker.tracks()


class Live:
    """Makes and tries changed checkpoints of a camera."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="phdtrack-fuzz-"))
        first = self.camera()
        self.show(first, 1, 12)
        first._saver(ended=False)()
        first.log.close()
        self.saved = from_bytes(zlib.decompress((self.folder / STATE).read_bytes()))
        self.ways = places(self.saved)
        self.try_one((self.folder / STATE).read_bytes())

    def camera(self) -> Camera:
        """One with a line, a zone and a delay."""
        source: Any = SimpleNamespace(
            status=lambda: SourceStatus(frames=100, fps=25.0), stop=lambda: None
        )
        line = Place("line", ((40.0, 59.0), (40.0, 0.0)), closed=False)
        zone = Place("zone", ((0.0, 0.0), (50.0, 0.0), (50.0, 59.0)), closed=True)
        watch = Watch((line, zone))
        detector = make_detector("change", min_area=0.005)

        def make(info: SequenceInfo) -> Making:
            found = load(None, ["associate.history=10", "associate.output_delay=2"])
            return Making(detector, build_classes(found, info), info, 2)

        return Camera(
            "gate", source, make, CameraSettings(self.folder, watch=watch, video=0, checkpoint=1e9)
        )

    def show(self, one: Camera, first: int, last: int) -> None:
        """Frames of the walk."""
        for k in range(first, last + 1):
            one._take(LiveFrame(k, k / 25, 1_790_000_000.0 + k / 25, Resumed.picture(k)))

    def make(self, rng: random.Random) -> bytes:
        """The file."""
        state = dict(self.saved)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            state = with_change(state, self.ways, rng)
        block = block_of(state, self.saved)
        return zlib.compress(flipped(block, rng) if rng.random() < 0.2 else block, 1)

    def try_one(self, content: bytes) -> None:
        """Start again and go on; what is said of the checkpoint refuses it."""
        warnings.simplefilter("ignore")
        (self.folder / STATE).write_bytes(content)
        one = self.camera()
        try:
            self.show(one, 13, 15)
            Page({"gate": one}).camera("gate")
            said = one.problems
        finally:
            one.stop(0.0)
        if said:
            raise InputError(said[0])


def block_of(value: Any, usual: Any) -> bytes:
    """A block of the value, or of the ``usual`` one where none can be made."""
    try:
        return to_bytes(value)
    except (InputError, TypeError, ValueError, OverflowError):
        return to_bytes(usual)


def _put(value: Any, way: Sequence[Any], new: Any) -> Any:
    """A copy with another value there."""
    if not way:
        return new
    out = value.copy() if isinstance(value, (dict, list)) else value
    out[way[0]] = _put(value[way[0]], way[1:], new)
    return out


def joined(total: Report, more: Report) -> None:
    """Add a further campaign, of the next seed."""
    total.inputs = total.inputs + more.inputs
    total.seconds = total.seconds + more.seconds
    total.failed = total.failed + more.failed
    total.accepted = total.accepted + more.accepted
    total.refused = total.refused + more.refused
    total.slowest = max(total.slowest, more.slowest)
    total.memory = max(total.memory, more.memory)
    for key, one in more.findings.items():
        total.findings.setdefault(key, one).times += one.times * (
            key in total.findings and total.findings[key] is not one
        )


FAMILIES: dict[str, Callable[[], Any]] = {"states": States, "track": Resumed, "live": Live}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 1 where there are findings."""
    out = argparse.ArgumentParser(prog="python -m experiments.fuzz_states", description=__doc__)
    out.add_argument("family", nargs="?", choices=FAMILIES, default="states")
    out.add_argument("--inputs", type=int, default=1000, metavar="N")
    out.add_argument("--seed", type=int, default=0, metavar="S")
    out.add_argument("--jobs", type=int, default=1, metavar="J")
    out.add_argument(
        "--out", type=Path, metavar="FILE.json", help="default: runs/reliability/fuzz-FAMILY.json"
    )
    out.add_argument(
        "--minutes",
        type=float,
        default=math.inf,
        metavar="M",
        help="end after so many, with what was done",
    )
    given = out.parse_args(arguments)
    file = given.out or ROOT / "runs" / "reliability" / f"fuzz-{given.family}.json"
    states = FAMILIES[given.family]()
    kept = file.parent / "fuzz-findings"
    end = time.monotonic() + 60 * given.minutes
    total = Report(given.family, 0, given.seed, Limits(60.0, 1 << 30))
    while total.inputs < given.inputs and time.monotonic() < end:
        count = min(CHUNK, given.inputs - total.inputs)
        seed = given.seed + total.inputs // CHUNK
        joined(total, campaign(given.family, states.make, states.try_one, inputs=count, seed=seed, jobs=given.jobs,
                               limits=total.limits, kept=kept))  # fmt: skip
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(
            json.dumps(total.document() | {"settings": list(SETTINGS)}, indent=1) + "\n",
            encoding="utf-8",
        )
    took = f"{total.inputs} inputs in {total.seconds / 60:.1f} minutes"
    print(
        f"{took}: {total.accepted} accepted, {total.refused} refused, {len(total.findings)}"
        " findings"
    )
    for one in total.findings.values():
        print(f"  {one.kind} {one.what} ({one.times} times; {one.file})")
    return int(bool(total.findings))


if __name__ == "__main__":
    raise SystemExit(main())
