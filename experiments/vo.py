"""The standard scenarios of Vo's papers, linear and nonlinear, and with unknown rates, for every
filter.
"""

from __future__ import annotations

from pathlib import Path

from experiments import nonlinear, standard, unknown
from experiments.common import Options, write


def main(options: Options) -> Path:
    """Measure all three, and write vo.md and its pictures."""
    sections = {
        "linear": standard.section(options),
        "unknown": unknown.section(options),
        "turning": nonlinear.section(options),
    }
    return write("vo", options, particles=standard.PER_TARGET, **sections)
