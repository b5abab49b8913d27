"""The filters: one recursion a file, its equations in the docstrings."""

from phdtrack.filters.none import NoFilter
from phdtrack.filters.particle_phd import ParticlePHD

__all__ = ["NoFilter", "ParticlePHD"]
