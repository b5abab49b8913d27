"""Damaged saved states: ``python -m experiments.fuzz_states [--inputs N] [--out FILE.json]``.

Every filter tracks a few frames of several targets and clutter, some with classes, an output delay
or a moving camera. Its saved states and the checkpoint of a live camera are damaged: cut off, bits
flipped, bytes inserted or exchanged, another format number. Each must be refused with a message and
change nothing. A state of other settings must be refused, too, and an intact one must load. The
exit status is 1 if one of these fails.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack import Tracker
from phdtrack.errors import InputError
from phdtrack.live.checkpoint import NAME, Checkpoints, SavedCamera, key_of, load
from phdtrack.live.events import WatchState
from phdtrack.state import FORMAT
from phdtrack.types import Detections

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 6
SIZE = (640, 480)
_FEW = {"particles_per_target": 30}
_GRAPH = {"associate": {"kind": "graph"}}
SETTINGS: dict[str, dict[str, Any]] = {
    "pmb": {},
    "pmb delay": {"associate": {"output_delay": 2}},
    "pmb classes": {"classes": {"together": [[2, 7]]}},
    "pmb graph": {**_GRAPH, "extract": {"min_weight": 0.3}},
    "pmb merged": {"merged_measurements": {"kind": "explained"}},
    "pmbm": {"filter": {"kind": "pmbm"}},
    "mht": {"filter": {"kind": "mht", "history": 3}, "associate": {"output_delay": 2}},
    "gm-phd": {"filter": {"kind": "gm-phd"}},
    "gm-cphd": {"filter": {"kind": "gm-cphd"}},
    "particle-phd": {"filter": {"kind": "particle-phd", **_FEW}, "birth": {"particles": 30}},
    "particle-cphd": {"filter": {"kind": "particle-cphd", **_FEW}, "birth": {"particles": 30}},
    "mcmc": {"filter": {"kind": "mcmc", "samples": 12, "burn_in": 4}},
    "none": {"filter": {"kind": "none"}},
}
MOVED = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])


def frame(k: int, rng: np.random.Generator, *, classes: bool) -> Detections:
    """Four walking targets and one false alarm, with scores and perhaps three classes."""
    target = np.arange(4)
    left = 60 + 150.0 * target + 3 * k * (-1) ** target
    top = 100 + 40.0 * target
    walking = np.column_stack([left, top, left + 40, top + 100]) + rng.normal(0, 1, (4, 4))
    corner = np.array([rng.uniform(0, 500), rng.uniform(0, 350)])
    false = np.concatenate([corner, corner + rng.uniform(30, 80, 2)])
    label = np.array([2, 7, 2, 1, 7]) * classes
    return Detections(np.vstack([walking, false]), rng.uniform(0.4, 0.95, 5), label)


def tracker_of(name: str, frames: int = 0) -> Tracker:
    """A tracker after a number of frames."""
    tracker = Tracker(SIZE, seed=1, **SETTINGS[name])
    rng = np.random.default_rng(3)
    for k in range(frames):
        warp = MOVED if name == "pmb" and k else None
        tracker.update(frame(k, rng, classes="classes" in name), warp=warp)
    return tracker


def damaged(content: bytes, rng: random.Random) -> bytes:
    """A damaged copy of these bytes."""
    out = bytearray(content)
    at = rng.randrange(len(out))
    match rng.randrange(6):
        case 0:
            del out[at:]
        case 1:
            out[at] ^= 1 << rng.randrange(8)
        case 2:
            out[at:at] = rng.randbytes(rng.choice((1, 8, 1000)))
        case 3:
            # Mostly in the header.
            out[rng.randrange(min(32, len(out)))] ^= 1 << rng.randrange(8)
        case 4:
            out += content
        case _:
            del out[at : at + rng.choice((1, 8, 1000))]
    if bytes(out) == content:
        return content[:-1]
    return bytes(out)


def refusal(attempt: Callable[[], object]) -> str:
    """The error message without its place; empty if the state was accepted."""
    try:
        attempt()
    except InputError as error:
        return error.problem
    return ""


def tracker_states(
    name: str, others: dict[str, Tracker], inputs: int, rng: random.Random
) -> Counter[str]:
    """Numbers of refusals by message, for damaged states of these settings and for states loaded by
    ``others``.
    """
    tracker = tracker_of(name, FRAMES)
    saved = tracker.state_dict()
    found = Counter[str]()
    for _ in range(inputs):
        broken = saved | {"state": damaged(saved["state"], rng)}
        found[refusal(lambda broken=broken: tracker.load_state_dict(broken))] += 1
    for change in ({"format": FORMAT - 1}, {"frame_size": "320x240"}, {"settings": "", "dim": 6}):
        found[refusal(lambda change=change: tracker.load_state_dict(saved | change))] += 1
    for other, fresh in others.items():
        if other != name:
            found[refusal(lambda fresh=fresh: fresh.load_state_dict(saved))] += 1
    tracker.load_state_dict(saved)
    tracker.update(frame(FRAMES, np.random.default_rng(4), classes="classes" in name))
    return found


def live_checkpoints(folder: Path, inputs: int, rng: random.Random) -> Counter[str]:
    """Numbers of refusals of damaged checkpoints of a live camera, by message."""
    maps = np.zeros((4, 6))
    camera = SavedCamera(9, 0.3, 1.8e9, (), WatchState(), (), maps, maps, 0.3, np.zeros((0, 4)))
    key = key_of({"filter.kind": "pmb"}, *SIZE)
    Checkpoints(folder).write(key, tracker_of("pmb", FRAMES).snapshot(), camera, 4)
    file = folder / NAME
    content = file.read_bytes()
    found = Counter[str]()
    for _ in range(inputs):
        broken = damaged(content, rng)
        while _unpacked(broken) == _unpacked(content):
            # A changed bit of packed data may stand for the same content.
            broken = damaged(content, rng)
        file.write_bytes(broken)
        found[refusal(lambda: load(folder, key))] += 1
    file.write_bytes(content)
    assert load(folder, key) is not None
    return found


def _unpacked(content: bytes) -> bytes | None:
    """What packed bytes hold; None if they are damaged."""
    try:
        return zlib.decompress(content)
    except zlib.error:
        return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Damage all kinds of states, and report how they are refused."""
    parser = argparse.ArgumentParser(prog="python -m experiments.fuzz_states", description=__doc__)
    parser.add_argument("--inputs", type=int, default=1000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "runs/reliability/fuzz-states.json")
    options = parser.parse_args(arguments)
    rng = random.Random(options.seed)
    begun = time.monotonic()
    fresh = {name: tracker_of(name) for name in SETTINGS}
    found = {name: tracker_states(name, fresh, options.inputs, rng) for name in SETTINGS}
    with tempfile.TemporaryDirectory() as folder:
        found["checkpoint.state"] = live_checkpoints(Path(folder), options.inputs, rng)
    accepted = sum(sentences.pop("", 0) for sentences in found.values())
    refused = sum(sum(sentences.values()) for sentences in found.values())
    document = {
        "refused": refused,
        "accepted": accepted,
        "seconds": round(time.monotonic() - begun, 1),
        "sentences": found,
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(f"{refused} damaged states refused, {accepted} accepted")
    return int(accepted > 0)


if __name__ == "__main__":
    raise SystemExit(main())
