"""Rates that a stream tells of itself, without truth: p_D, false alarms, births, the worth of the detector's scores."""

from phdtrack.rates.following import Following, Learned, Learns, advance, begin
from phdtrack.rates.known import Counted, Known, Priors, Rates
from phdtrack.rates.noise import Moments, Noise
from phdtrack.rates.scores import Judged, Scale, Successive
from phdtrack.rates.settings import RatesSettings

__all__ = [
    "Counted",
    "Following",
    "Judged",
    "Known",
    "Learned",
    "Learns",
    "Moments",
    "Noise",
    "Priors",
    "Rates",
    "RatesSettings",
    "Scale",
    "Successive",
    "advance",
    "begin",
]
