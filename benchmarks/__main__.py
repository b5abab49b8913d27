"""Speed and memory, measured in one run on this machine.

    python -m benchmarks [--full] [--only NAME …] [--out FILE]

Prints one table and writes benchmarks/out/bench.json: machine, versions, seeds, medians, quartiles,
and the ratios to the peers within the run. A part that fails or cannot be measured here leaves its
reason, and the others go on.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks import report
from benchmarks.parts import FULL, QUICK, SCALES, Outcome, Part, Scale, Skipped
from benchmarks.registry import PARTS

# NumPy's libraries would otherwise take all cores in some places, and each side of a comparison in
# others.
PINNED = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def measure(parts: Sequence[Part], scale: Scale, out: Path, paper: report.Paper) -> dict[str, Any]:
    """Run the parts, and write the document after each: what was measured is not lost."""
    from phdtrack.run.environment import versions

    document: dict[str, Any] = {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "scale": scale.name,
        "seeds": list(scale.seeds),
        "machine": report.machine(),
        "versions": dict(versions()),
        "parts": {},
        **{key: None for part in parts for key in part.keys},
    }
    for part in parts:
        began = time.perf_counter()
        outcome, status, reason = _tried(part, scale)
        spent = time.perf_counter() - began
        document["parts"][part.name] = {
            "status": status,
            "reason": reason,
            "seconds": spent,
            "rows": _rows(outcome),
        }
        document.update(outcome.entries)
        paper.part(part.title, outcome.rows, f"{status}: {reason}" if reason else "")
        report.write(document, out)
        _progress(f"{part.name}: {status} in {spent:.0f} s {reason}")
    return document


def _tried(part: Part, scale: Scale) -> tuple[Outcome, str, str]:
    """The outcome of a part, and whether it was done, skipped or failed, and why."""
    try:
        return part.run(scale, lambda text: _progress(f"{part.name}: {text}")), "done", ""
    except Skipped as reason:
        return Outcome(()), "skipped", str(reason)
    except Exception as error:  # one part's failure is a finding, the others go on
        traceback.print_exc(limit=-3)
        return Outcome(()), "failed", f"{type(error).__name__}: {error}"


def _progress(text: str) -> None:
    """A line on stderr about what is being measured."""
    print(f"  … {text}", file=sys.stderr, flush=True)


def _rows(outcome: Outcome) -> list[dict[str, Any]]:
    return [
        {
            "what": row.what,
            "value": row.value,
            "cpu": row.cpu,
            "unit": row.unit,
            "spread": row.spread.as_dict() if row.spread else None,
            "most": row.most,
            "least": row.least,
            "kept": row.kept,
            "note": row.note,
        }
        for row in outcome.rows
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 1 where a part failed."""
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Speed and memory, measured in one run."
    )
    parser.add_argument(
        "--full",
        action="store_true",
        help="all parts and sizes, more frames and seeds (about half an hour)",
    )
    parser.add_argument(
        "--smoke", action="store_true", help="seconds: shows that everything runs, not how fast"
    )
    parser.add_argument(
        "--only", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}"
    )
    parser.add_argument(
        "--out", type=Path, default=report.OUT / "bench.json", help="where the numbers go"
    )
    given = parser.parse_args(arguments)
    scale = SCALES["smoke"] if given.smoke else FULL if given.full else QUICK
    began = time.perf_counter()
    wanted = given.only or [part.name for part in PARTS if part.quick or scale is not QUICK]
    parts = [part for part in PARTS if part.name in wanted]
    paper = report.Paper()
    document = measure(parts, scale, given.out, paper)
    paper.show()
    done = document["parts"].values()
    broken = [row["what"] for part in done for row in part["rows"] if row["kept"] is False]
    busy = document["machine"]["load_at_start"]
    if busy is not None and busy > 0.5:
        print(
            f"The machine was busy (load {busy:.1f} at the start): times mean little, ratios more."
        )
    print(
        f"{given.out}: {scale.name}, {time.perf_counter() - began:.0f} s; limits not kept:"
        f" {len(broken)}"
    )
    for what in broken:
        print(f"  {what}")
    return int(any(part["status"] == "failed" for part in done))


if __name__ == "__main__":
    if any(os.environ.get(name) != value for name, value in PINNED.items()):
        # The libraries read these when they are loaded, so the process begins again.
        os.execve(
            sys.executable,
            [sys.executable, "-m", "benchmarks", *sys.argv[1:]],
            {**os.environ, **PINNED},
        )
    sys.exit(main())
