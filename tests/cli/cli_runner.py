"""Runs the command line in this process, as a terminal would: arguments in; status, stdout and
stderr out.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from phdtrack.cli.app import application


@dataclass(frozen=True)
class Said:
    """What a command said, and its exit status."""

    status: int
    out: str
    err: str

    @property
    def object(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        value = json.loads(self.out)
        assert isinstance(value, dict)
        return value


def phdtrack(*arguments: object) -> Said:
    """Run ``phdtrack`` with the arguments."""
    words = [str(argument) for argument in arguments]
    result = CliRunner().invoke(application(words[0]), words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Said(result.exit_code, result.stdout, result.stderr)


def refused(*arguments: object) -> str:
    """Run it, expect one sentence on stderr and status 2, nothing on stdout; the sentence."""
    said = phdtrack(*arguments)
    assert said.status == 2, said
    assert said.out == ""
    assert "Traceback" not in said.err
    sentence = said.err.strip()
    assert sentence.startswith("phdtrack: ")
    assert "\n" not in sentence, sentence
    return sentence


def walkers(folder: Path, frames: int = 40, *, clutter: int = 0, seqinfo: bool = True) -> Path:
    """A small sequence in MOTChallenge's layout: two people crossing a frame of 320x240 at 25 Hz;
    gives ``folder``.
    """
    rng = np.random.default_rng(3)
    truth = []
    found = []
    for k in range(1, frames + 1):
        for identity, x, y in ((1, 20 + 5 * k, 60), (2, 270 - 5 * k, 150)):
            truth.append(f"{k},{identity},{x},{y},24,60,1,-1,-1,-1")
            dx, dy = rng.normal(0, 1, 2)
            found.append(f"{k},-1,{x + dx:.2f},{y + dy:.2f},24,60,1,-1,-1,-1")
        for _ in range(clutter):
            x = rng.uniform(0, 290)
            y = rng.uniform(0, 180)
            found.append(f"{k},-1,{x:.2f},{y:.2f},24,60,1,-1,-1,-1")
    (folder / "gt").mkdir(parents=True)
    (folder / "det").mkdir()
    (folder / "gt" / "gt.txt").write_text("\n".join(truth) + "\n")
    (folder / "det" / "det.txt").write_text("\n".join(found) + "\n")
    if seqinfo:
        lines = [
            "[Sequence]",
            "name=walkers",
            "frameRate=25",
            f"seqLength={frames}",
            "imWidth=320",
            "imHeight=240",
            "",
        ]
        (folder / "seqinfo.ini").write_text("\n".join(lines))
    return folder
