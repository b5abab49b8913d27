"""The filters: one recursion a file, its equations in the docstrings."""

from phdtrack.filters.gm_cphd import GMCPHD
from phdtrack.filters.gm_phd import GMPHD
from phdtrack.filters.mcmc import MCMC
from phdtrack.filters.mht import MHT
from phdtrack.filters.none import NoFilter
from phdtrack.filters.particle_cphd import ParticleCPHD
from phdtrack.filters.particle_phd import ParticlePHD
from phdtrack.filters.pmb import PMB

__all__ = ["GMCPHD", "GMPHD", "MCMC", "MHT", "PMB", "NoFilter", "ParticleCPHD", "ParticlePHD"]
