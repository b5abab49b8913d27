"""Multiple hypothesis tracking: Reid's hypotheses about which measurements are whose."""

from phdtrack.filters.mht.filter import MHT

__all__ = ["MHT"]
