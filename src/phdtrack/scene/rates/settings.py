"""Which rates are learned and used: the section ``rates`` of the settings."""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.checks import NonNegative, Positive, check
from phdtrack.scene.rates.following import Following, Learns
from phdtrack.scene.rates.known import Priors


@dataclass(frozen=True, slots=True)
class RatesSettings:
    """Rates that are learned from the stream while tracking, from those of the other sections on, see `rates`.

    All are estimated and reported; which of them the filter uses is said here. As shipped it uses what the scores are worth.

    Parameters
    ----------
    detection : whether the p_D that is learned is used; otherwise ``sensor.detection_probability`` holds.
    clutter : whether the rate of false alarms is; otherwise ``clutter.clutter_per_frame`` holds.
    birth : whether the rate of births is; otherwise ``birth.births_per_second`` holds.
    scores : whether what the detector's scores are worth is used; otherwise they are not looked at.
    noise : whether the noises of measurements and motion are; otherwise ``sensor.box_noise``, ``motion.acceleration`` and
        ``motion.size_noise`` hold, which are made for links that are hard as well as for those that are easy.
    cautious : whether p_D is used only where it is lower, and the rates of false alarms and births where they are higher,
        than is set: tracks that break make p_D look too high, false alarms that come again in one place make themselves
        look too few, and who was never believed is not among the births.
    memory : seconds after which a frame counts for 37 %.
    verdict_delay : seconds until a detection is judged, beyond ``associate.output_delay``.
    update_interval : seconds between two times of learning.
    """

    detection: bool = False
    clutter: bool = False
    birth: bool = False
    scores: bool = True
    noise: bool = False
    cautious: bool = True
    memory: Positive = 120.0
    verdict_delay: NonNegative = 1.0
    update_interval: NonNegative = 1.0

    def __post_init__(self) -> None:
        check(self)

    def rule(self, priors: Priors, rate: float, delay: float) -> Following:
        """How rates are followed, with ``rate`` time units a second and rows that come ``delay`` seconds late."""
        learns = Learns(self.detection, self.clutter, self.birth, self.scores, self.noise)
        return Following(priors, rate, self.memory, self.verdict_delay + delay, self.update_interval, learns, self.cautious)
