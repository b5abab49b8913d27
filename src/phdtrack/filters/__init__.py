"""The filters: one recursion a file, its equations in the docstrings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.filters.cphd import GMCPHD
    from phdtrack.filters.cphd_particle import ParticleCPHD
    from phdtrack.filters.mcmc import MCMC
    from phdtrack.filters.mht import MHT, BestHypothesis
    from phdtrack.filters.none import NoFilter
    from phdtrack.filters.phd_gaussian import GMPHD
    from phdtrack.filters.phd_particle import ParticlePHD
    from phdtrack.filters.pmb import PMB, BestBernoullis

__getattr__, __dir__ = lazy(
    __name__,
    {
        "BestBernoullis": "phdtrack.filters.pmb",
        "BestHypothesis": "phdtrack.filters.mht",
        "GMCPHD": "phdtrack.filters.cphd",
        "GMPHD": "phdtrack.filters.phd_gaussian",
        "MCMC": "phdtrack.filters.mcmc",
        "MHT": "phdtrack.filters.mht",
        "NoFilter": "phdtrack.filters.none",
        "PMB": "phdtrack.filters.pmb",
        "ParticleCPHD": "phdtrack.filters.cphd_particle",
        "ParticlePHD": "phdtrack.filters.phd_particle",
    },
)

__all__ = [
    "GMCPHD",
    "GMPHD",
    "MCMC",
    "MHT",
    "PMB",
    "BestBernoullis",
    "BestHypothesis",
    "NoFilter",
    "ParticleCPHD",
    "ParticlePHD",
]
