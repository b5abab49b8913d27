"""How good are tracks: VACE and CLEAR scores, IDF1, HOTA, OSPA, GOSPA, T-GOSPA, RMSE, lives of
tracks, causes of errors.
"""

from phdtrack.metrics.causes import Errors, explain
from phdtrack.metrics.scores import Scores, evaluate, pool
from phdtrack.metrics.trajectories import TargetErrors, TGospaParts, rmse_per_target, tgospa_boxes

__all__ = [
    "Errors",
    "Scores",
    "TGospaParts",
    "TargetErrors",
    "evaluate",
    "explain",
    "pool",
    "rmse_per_target",
    "tgospa_boxes",
]
