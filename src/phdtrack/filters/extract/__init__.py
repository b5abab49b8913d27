"""From an intensity to states: modified K-means, EM, the components of a mixture, or the detections themselves.

Where the filter knows the distribution of the number of targets, as many peaks as it says; where it knows each, those.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.filters.extract.components import Components
    from phdtrack.filters.extract.joint import Joint
    from phdtrack.filters.extract.kmeans import KMeans
    from phdtrack.filters.extract.mixture import Mixture
    from phdtrack.filters.extract.raw import Raw

__getattr__, __dir__ = lazy(
    __name__,
    {
        "Components": "phdtrack.filters.extract.components",
        "Joint": "phdtrack.filters.extract.joint",
        "KMeans": "phdtrack.filters.extract.kmeans",
        "Mixture": "phdtrack.filters.extract.mixture",
        "Raw": "phdtrack.filters.extract.raw",
    },
)

__all__ = ["Components", "Joint", "KMeans", "Mixture", "Raw"]
