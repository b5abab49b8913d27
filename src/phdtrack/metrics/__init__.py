"""How good are tracks: VACE and CLEAR scores, IDF1, HOTA, OSPA, GOSPA, T-GOSPA, RMSE, lives of tracks."""

from phdtrack.metrics.lifetimes import Delays, first_output_delays
from phdtrack.metrics.scores import Scores, Settings, evaluate, pool
from phdtrack.metrics.sets import GospaParts, gospa, gospa_of, gospa_parts, gospa_parts_of, ospa, ospa_of
from phdtrack.metrics.trajectories import (
    TargetErrors,
    TGospaParts,
    rmse_per_target,
    tgospa_boxes,
    tgospa_of,
)

__all__ = [
    "Delays",
    "GospaParts",
    "Scores",
    "Settings",
    "TGospaParts",
    "TargetErrors",
    "evaluate",
    "first_output_delays",
    "gospa",
    "gospa_of",
    "gospa_parts",
    "gospa_parts_of",
    "ospa",
    "ospa_of",
    "pool",
    "rmse_per_target",
    "tgospa_boxes",
    "tgospa_of",
]
