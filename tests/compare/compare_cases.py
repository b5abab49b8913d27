"""Small sequences to compare on: two people who walk past each other, seen with noise, misses and a
few false alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.compare import Plan, Request, plan

FRAMES = 30


def sequence(
    folder: Path, seed: int = 3, sets: tuple[str, ...] = ("det",), truth: bool = True
) -> Path:
    """A folder as MOTChallenge lays it out, 320x240 at 25 Hz; gives it back."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    lines = [
        "[Sequence]",
        "name=other",
        "frameRate=25",
        f"seqLength={FRAMES}",
        "imWidth=320",
        "imHeight=240",
        "",
    ]
    (folder / "seqinfo.ini").write_text("\n".join(lines))
    rows = [
        (k, i, x, y)
        for k in range(1, FRAMES + 1)
        for i, x, y in ((1, 20 + 5 * k, 60), (2, 270 - 5 * k, 150))
    ]
    if truth:
        (folder / "gt").mkdir()
        (folder / "gt" / "gt.txt").write_text(
            "".join(f"{k},{i},{x},{y},24,60,1,-1,-1,-1\n" for k, i, x, y in rows)
        )
    for name in sets:
        seen = [
            (k, x + rng.normal(), y + rng.normal()) for k, _, x, y in rows if rng.random() < 0.9
        ]
        seen += [
            (k, rng.uniform(0, 290), rng.uniform(0, 180))
            for k in range(1, FRAMES + 1)
            if rng.random() < 0.3
        ]
        (folder / name).mkdir()
        text = "".join(f"{k},-1,{x:.2f},{y:.2f},24,60,1,-1,-1,-1\n" for k, x, y in sorted(seen))
        (folder / name / "det.txt").write_text(text)
    return folder


def small(folder: Path, **more: Any) -> Plan:
    """Two sequences, one Gaussian filter and none, two seeds; ``more`` as `planned` has it."""
    for name, seed in (("a", 3), ("b", 4)):
        if not (folder / name).exists():
            sequence(folder / name, seed)
    return planned(
        [folder / "a", folder / "b"], **({"filters": ["gm-phd", "none"], "seeds": 2} | more)
    )


def planned(folders: Sequence[Path | str], **more: Any) -> Plan:
    """The plan of a `Request`."""
    return plan(Request([str(folder) for folder in folders], **more))
