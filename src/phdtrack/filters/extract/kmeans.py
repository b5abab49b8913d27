"""Modified K-means: states are the centres of clusters of particles [M07 §3].

Clusters start on the frame's detections with zero velocity. While a cluster is heavier than the split mass, a new centre
is put on its particle farthest from the centre; clusters lighter than a threshold are dropped.

The paper splits above mass 1. But one well-seen target settles at up to 1/(1 − p_M p_S): 1.05 at p_D = 0.95 and 1.42 at
p_D = 0.7, so its halves would both fall below the threshold of 0.6 and it would vanish. The split mass here is 1.5: above
what one target can weigh down to p_D = 0.67, below what two weigh once they are believed, and half of it is still above the
threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.errors import Count, Positive, PositiveCount, Share, check
from phdtrack.filters.extract import clusters, settling
from phdtrack.filters.extract.cloud import Cloud
from phdtrack.filters.extract.counted import LIGHTEST_CLUSTER, NEVER_SPLIT, heaviest
from phdtrack.filters.extract.resolution import join_unresolved
from phdtrack.filters.intensities import Cardinalised
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, ParticleBlocks, Particles

Intensity = Particles | ParticleBlocks


@dataclass(frozen=True, slots=True)
class KMeans:
    """Settings of the modified K-means.

    Parameters
    ----------
    min_weight : T, clusters of less mass are not targets; M07's 0.6.
    split_weight : clusters of more mass are several targets.
    iterations : how often a cluster's centre may move, and again after each split of it.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    threads : threads that share a frame's work, 0 for one per core; the result is the same to the bit.
    counted : of a cardinalised filter, report as many states as its number of targets says; of others it changes nothing.
    """

    min_weight: Positive = 0.6
    split_weight: Positive = 1.5
    iterations: PositiveCount = 5
    merge_iou: Share = 0.4
    threads: Count = 1
    counted: bool = True

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Intensity | Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The centres of the clusters heavy enough to be targets: weighted means of full states [M07 §3]."""
        if not isinstance(state, Cardinalised):
            return self._peaks(state, self.min_weight, self.split_weight, z, model)
        if not self.counted:
            return self._peaks(state.intensity, self.min_weight, self.split_weight, z, model)
        return heaviest(self._peaks(state.intensity, LIGHTEST_CLUSTER, NEVER_SPLIT, z, model), state.cardinality)

    def _peaks(self, state: Intensity, lightest: float, split: float, z: F8, model: Model) -> Estimates:
        """The clusters of at least the mass ``lightest``; those above ``split`` are divided."""
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor, cloud = model.sensor, Cloud.of(state, self.threads, settling.FEW)
        start = clusters.seeds(cloud, z, sensor, lightest)
        found = settling.cluster(cloud, start, split, self.iterations)
        heavy = clusters.heavy_enough(found, sensor, lightest, split)
        return clusters.finish(*join_unresolved(*heavy, sensor, self.merge_iou), z, model)
