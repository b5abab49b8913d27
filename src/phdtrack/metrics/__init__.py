"""How good are tracks: VACE and CLEAR scores, IDF1, HOTA, OSPA, GOSPA, T-GOSPA, RMSE, lives of tracks."""

from phdtrack.metrics.scores import Scores, evaluate, pool
from phdtrack.metrics.trajectories import TargetErrors, TGospaParts, rmse_per_target, tgospa_boxes

__all__ = [
    "Scores",
    "TGospaParts",
    "TargetErrors",
    "evaluate",
    "pool",
    "rmse_per_target",
    "tgospa_boxes",
]
