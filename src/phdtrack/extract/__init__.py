"""From an intensity to states: modified K-means, a Gaussian mixture by EM, or the detections themselves."""

from phdtrack.extract.kmeans import KMeans
from phdtrack.extract.mixture import Mixture
from phdtrack.extract.raw import Raw

__all__ = ["KMeans", "Mixture", "Raw"]
