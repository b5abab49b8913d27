"""From an intensity to states: modified K-means, EM, the components of a mixture, or the detections themselves."""

from phdtrack.extract.components import Components
from phdtrack.extract.kmeans import KMeans
from phdtrack.extract.mixture import Mixture
from phdtrack.extract.raw import Raw

__all__ = ["Components", "KMeans", "Mixture", "Raw"]
