"""Blobs and targets: what a change detector reports is not one blob per target.

Targets that touch become one blob; one target falls into pieces. Between detector and filter, what is expected explains
what was found: `Explained` finds the best explanation of every small group of blobs and targets that touch, and hands the
filter one detection for each target.
"""

from phdtrack.detect.merged.expected import Expected
from phdtrack.detect.merged.explained import Explained

__all__ = ["Expected", "Explained"]
