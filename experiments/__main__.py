"""The papers' experiments: ``python -m experiments m07 [--quick]``; all of them without a name."""

from __future__ import annotations

from experiments.common import Options
from experiments.registry import EXPERIMENTS


def main() -> None:
    """Every experiment, the short ones first."""
    for experiment in EXPERIMENTS.values():
        experiment.run(Options())


if __name__ == "__main__":
    main()
