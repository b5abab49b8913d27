"""Bytes per particle at the peak of a step, and memory along a sequence; measured in processes of
their own.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.parts import Outcome, Row, Scale, Skipped

KEYS = ("bytes_per_particle", "memory")
# What the allocator may keep: the number of particles varies by itself.
FLAT = 4 * 2**20


def asked(what: str, number: int) -> dict[str, Any]:
    """Return what `benchmarks.memory_process` prints."""
    command = [sys.executable, "-m", "benchmarks.memory_process", what, str(number)]
    root = Path(__file__).resolve().parent.parent
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=root)
    if done.returncode:
        raise RuntimeError(
            f"memory_process {what} ended with:"
            f" {(done.stderr.strip().splitlines() or ['no word'])[-1]}"
        )
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """The filter's peak, and the growth along a sequence of filter and extraction, and of the whole
    tracker.
    """
    if not Path("/proc/self/clear_refs").exists():
        raise Skipped(
            "this system does not tell a process's peak memory and set it back (Linux does)"
        )
    say(f"peak, {scale.memory_at} targets")
    top = asked("peak", scale.memory_at)
    rows = [
        Row(
            f"filter, {scale.memory_at} targets, worst births",
            top["filter"],
            "bytes/particle",
            most=64.0,
            note=(
                f"{top['particles']:,} particles old and newborn; with extraction"
                f" {top['filter_and_extraction']:.1f}"
            ),
        ),
        Row("peak of the process", top["peak"] / 2**20, "MiB"),
    ]
    entries: dict[str, Any] = {"peak": top}
    for what, name in (
        ("flat", "filter and extraction"),
        ("tracker", "whole tracker, which keeps its tracks"),
    ):
        say(f"{name}, {scale.memory_frames} frames")
        along = asked(what, scale.memory_frames)
        entries[what] = along
        most = FLAT / 2**20 if what == "flat" else None
        rows.append(
            Row(
                f"growth over {scale.memory_frames} frames, {name}",
                along["grown"] / 2**20,
                "MiB",
                most=most,
                note=f"{along['bytes_per_frame']:.0f} bytes per frame",
            )
        )
    return Outcome(tuple(rows), {"bytes_per_particle": top["filter"], "memory": entries})
