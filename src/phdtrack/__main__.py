"""``python -m phdtrack``: the same as the command ``phdtrack``."""

from phdtrack.cli.app import main

if __name__ == "__main__":
    main()
