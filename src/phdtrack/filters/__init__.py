"""The filters: one recursion a file, its equations in the docstrings."""

from phdtrack.filters.gm_phd import GMPHD
from phdtrack.filters.none import NoFilter
from phdtrack.filters.particle_phd import ParticlePHD

__all__ = ["GMPHD", "NoFilter", "ParticlePHD"]
