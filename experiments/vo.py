"""The standard scenarios of Vo's papers, linear and not, and with rates unknown: every filter, `phdtrack reproduce vo`."""

from __future__ import annotations

from pathlib import Path

from experiments import nonlinear, standard, unknown
from experiments.common import Options, write
from experiments.scans import fill


def main(options: Options | None = None) -> Path:
    """Measure both, and write vo.md and its pictures."""
    options = options or Options()
    sections = {
        "linear": standard.section(options),
        "unknown": unknown.section(options),
        "turning": nonlinear.section(options),
    }
    return write("vo.md", fill("vo.md", particles=standard.PER_TARGET, **sections), options.out)


if __name__ == "__main__":
    main()
