"""What a rendered scene looks like, and how hard it is to see change in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError


@dataclass(frozen=True, slots=True)
class Look:
    """What the picture looks like.

    Attributes
    ----------
    noise : standard deviation of the camera's noise, grey levels.
    flicker : relative standard deviation of the brightness of the whole picture.
    plants : number of waving plants where the scene has no persistent places; where it has, one grows at each.
    wave : how far the top of a plant moves in a usual gust, in plant heights.
    blown : leaves that the wind blows past the camera, expected number per frame; each is in one frame only.
    lamps : number of blinking lights and shimmering reflections.
    shadow : darkness of the shadows, 0 to 1.
    """

    noise: float = 2.0
    flicker: float = 0.03
    plants: int = 4
    wave: float = 0.09
    lamps: int = 3
    shadow: float = 0.35
    blown: float = 0.0

    def __post_init__(self) -> None:
        amounts = (self.noise, self.flicker, self.plants, self.wave, self.lamps, self.shadow, self.blown)
        if not all(0 <= amount < np.inf for amount in amounts) or self.shadow > 1:
            raise InputError(
                "noise, flicker, plants, wave, lamps, shadow and blown must not be negative, shadow not above 1, "
                f"not {amounts}",
                where="look of the rendered scene",
                cure="Give 0 to leave something out",
            )
