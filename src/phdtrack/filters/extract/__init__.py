"""From an intensity to states: modified K-means, EM, the components of a mixture, or the detections themselves.

Where the filter knows the distribution of the number of targets, as many peaks as it says; where it knows each, those.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.filters.extract.clusters import KMeans, Mixture
    from phdtrack.filters.extract.components import Components, Joint, Raw

__getattr__, __dir__ = lazy(
    __name__,
    {
        **dict.fromkeys(("KMeans", "Mixture"), "phdtrack.filters.extract.clusters"),
        **dict.fromkeys(("Components", "Joint", "Raw"), "phdtrack.filters.extract.components"),
    },
)

__all__ = ["Components", "Joint", "KMeans", "Mixture", "Raw"]
