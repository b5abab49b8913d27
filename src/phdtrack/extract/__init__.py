"""From an intensity to states: modified K-means, EM, the components of a mixture, or the detections themselves.

Where the filter knows the distribution of the number of targets, as many peaks as it says; where it knows each, those.
"""

from phdtrack.extract.bernoullis import BestBernoullis
from phdtrack.extract.components import Components
from phdtrack.extract.counted import CountedComponents, CountedKMeans, CountedMixture
from phdtrack.extract.hypotheses import BestHypothesis
from phdtrack.extract.joint import Joint
from phdtrack.extract.kmeans import KMeans
from phdtrack.extract.mixture import Mixture
from phdtrack.extract.raw import Raw

__all__ = [
    "BestBernoullis",
    "BestHypothesis",
    "Components",
    "CountedComponents",
    "CountedKMeans",
    "CountedMixture",
    "Joint",
    "KMeans",
    "Mixture",
    "Raw",
]
