"""Scores of tracks: VACE, CLEAR, IDF1, HOTA, OSPA, GOSPA, T-GOSPA, RMSE, and causes of errors."""

from phdtrack.metrics.causes import Errors, explain
from phdtrack.metrics.identity_errors import IdentityError
from phdtrack.metrics.rmse import TargetErrors, rmse_per_target
from phdtrack.metrics.scores import Scores, evaluate, pool
from phdtrack.metrics.tgospa import TGospaParts, tgospa_boxes

__all__ = [
    "Errors",
    "IdentityError",
    "Scores",
    "TGospaParts",
    "TargetErrors",
    "evaluate",
    "explain",
    "pool",
    "rmse_per_target",
    "tgospa_boxes",
]
