"""The filters: one recursion a file, its equations in the docstrings, with its state and what reads
it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.filters.cphd import GMCPHD, ParticleCPHD
    from phdtrack.filters.extract import Components, KMeans, Mixture, PrintedKMeans, PrintedMixture
    from phdtrack.filters.mcmc import MCMC, Joint
    from phdtrack.filters.none import NoFilter, Raw
    from phdtrack.filters.phd_gaussian import GMPHD
    from phdtrack.filters.phd_particle import ParticlePHD
    from phdtrack.filters.pmb import PMB, BestBernoullis
    from phdtrack.filters.pmbm import MHT, PMBM, BestHypothesis

# Type checkers know the names by their imports, and find one that does not exist.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            **dict.fromkeys(("GMCPHD", "ParticleCPHD"), "phdtrack.filters.cphd"),
            **dict.fromkeys(
                ("Components", "KMeans", "Mixture", "PrintedKMeans", "PrintedMixture"),
                "phdtrack.filters.extract",
            ),
            **dict.fromkeys(("MCMC", "Joint"), "phdtrack.filters.mcmc"),
            **dict.fromkeys(("NoFilter", "Raw"), "phdtrack.filters.none"),
            "GMPHD": "phdtrack.filters.phd_gaussian",
            "ParticlePHD": "phdtrack.filters.phd_particle",
            **dict.fromkeys(("PMB", "BestBernoullis"), "phdtrack.filters.pmb"),
            **dict.fromkeys(("MHT", "PMBM", "BestHypothesis"), "phdtrack.filters.pmbm"),
        },
    )

__all__ = [
    "GMCPHD",
    "GMPHD",
    "MCMC",
    "MHT",
    "PMB",
    "PMBM",
    "BestBernoullis",
    "BestHypothesis",
    "Components",
    "Joint",
    "KMeans",
    "Mixture",
    "NoFilter",
    "ParticleCPHD",
    "ParticlePHD",
    "PrintedKMeans",
    "PrintedMixture",
    "Raw",
]
