"""All measured tables: `make experiments`. One alone: `phdtrack reproduce NAME`."""

from __future__ import annotations

from phdtrack.reproduce.common import Options
from phdtrack.reproduce.experiments import EXPERIMENTS


def main() -> None:
    """Every experiment, the short ones first."""
    for experiment in EXPERIMENTS.values():
        experiment.run(Options())


if __name__ == "__main__":
    main()
