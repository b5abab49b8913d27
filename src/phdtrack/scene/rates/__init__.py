"""Rates that a stream tells of itself, without truth: p_D, false alarms, births, the worth of the detector's scores."""

from phdtrack.scene.rates.following import Following, Learned, Learns, advance, begin
from phdtrack.scene.rates.known import Counted, Known, Priors, Rates
from phdtrack.scene.rates.noise import Moments, Noise
from phdtrack.scene.rates.scores import Judged, Scale, Successive
from phdtrack.scene.rates.settings import RatesSettings

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
