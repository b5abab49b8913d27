"""How the light of a scene changes, and which places do not follow it.

A change of the light scales all pixels of a channel by about a gain and adds an offset, and
`kernels.planes.lighting` fits both. Outdoors, clouds hide the sun and not the sky: what lies in the
sun changes most, what lies in the shade less, and the sky not at all. So each number p of a picture
has a response r(p), learned from samples of a file,

    picture(p) = light(scene)(p) + (g − 1) · r(p),

with g the gain of brightness, measured where the scene follows the light. A picture less the last
term is *even*: all of it follows the light.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.detect.reference import median
from phdtrack.kernels.planes import inverse_light, lighting, luma, relit
from phdtrack.types import F4, Image

# The response is learned if the thirds of the samples with the most and the least light differ by
# this gain, and have so many samples.
_LIGHT_CHANGES = 0.2
_FEWEST = 3
# The share of the samples that are darker than the one in whose light the response is learned.
_BRIGHT = 0.83
# Places follow the light if, when it doubles, they are at most so many grey levels off.
_FOLLOWS = 40.0
# Every how many pixels the brightness of a picture is measured.
_SPARSE = 8


class SceneLight:
    """The response of a scene to its light."""

    def __init__(self, shape: tuple[int, int], step: int) -> None:
        """``shape``: (H, W) of the pictures; the light is fitted to every ``step``-th pixel."""
        self._shape = shape
        self._step = step
        self._nothing: Image = np.zeros(shape, np.uint8)
        # (H, W) not 0 where the scene does not follow the light.
        self._unlike: Image = self._nothing
        self._response: F4 | None = None
        self._gains = (1.0, 1.0)

    def levelled(self, pictures: Sequence[Image]) -> list[Image]:
        """Learn the response from pictures (n,); they in one light."""
        sparse = (slice(None, None, _SPARSE),) * 2
        brightness = [float(luma(one, self._shape)[sparse].mean()) for one in pictures]
        order = np.argsort(brightness)
        # In the light of a dark picture a sky that stays bright would be brighter than white.
        bright = pictures[int(order[round(_BRIGHT * (len(order) - 1))])].astype(np.float32)
        self._response = response(pictures, self._lights(bright, pictures), self._shape)
        if self._response is None:
            usual = pictures[int(order[len(order) // 2])].astype(np.float32)
            return self._relit(pictures, self._lights(usual, pictures))
        off = np.abs(luma(self._response, self._shape)) > _FOLLOWS
        self._unlike = np.asarray(off, np.uint8)
        gains = [self._gain(bright, one, self._nothing) for one in pictures]
        self._gains = (min(gains), max(gains))
        even = [
            self._less(one, self._response, gain) for one, gain in zip(pictures, gains, strict=True)
        ]
        return self._relit(even, self._lights(bright, even))

    def _lights(self, scene: F4, pictures: Sequence[Image]) -> list[F4]:
        """The light (3, 4) of each picture (n,), from that of the scene (n,)."""
        return [lighting(scene, one, self._nothing, self._step) for one in pictures]

    def _relit(self, pictures: Sequence[Image], lights: Sequence[F4]) -> list[Image]:
        """The pictures (n,) in the light from which ``lights`` lead to theirs."""
        return [relit(*one, self._shape) for one in zip(pictures, lights, strict=True)]

    def even(self, picture: Image, reference: F4, foreground: Image) -> Image:
        """(n,) a picture as if all of the scene followed the light.

        Parameters
        ----------
        picture : (n,) its planes.
        reference : (n,) the scene.
        foreground : (H, W) not 0 where objects hide it.
        """
        if self._response is None:
            return picture
        return self._less(picture, self._response, self._gain(reference, picture, foreground))

    def _gain(self, reference: F4, picture: Image, foreground: Image) -> float:
        """The gain of brightness where the scene follows the light."""
        light = lighting(reference, picture, foreground | self._unlike, self._step)
        return float(light[0, 0])

    def _less(self, picture: Image, response: F4, gain: float) -> Image:
        """The picture without its response to a light of this gain."""
        # Beyond the light of the samples the response is unknown.
        known = min(max(gain, self._gains[0]), self._gains[1])
        even = picture - np.float32(known - 1) * response
        return np.asarray(np.clip(even + np.float32(0.5), 0, 255), np.uint8)


def response(samples: Sequence[Image], lights: Sequence[F4], shape: tuple[int, int]) -> F4 | None:
    """(n,) the response of each number of the scene; None if the light hardly changes.

    It is measured on the third of the samples with the least light, against the scene as the third
    with the most light shows it.

    Parameters
    ----------
    samples : pictures (n,).
    lights : the light (3, 4) of each, from a light of usual strength, as `kernels.planes.lighting`
        returns it.
    shape : (H, W) of the pictures.
    """
    gains = np.array([light[0, 0] for light in lights])
    order = np.argsort(gains)
    third = (len(order) // 3 - 1) | 1
    dark = order[:third]
    bright = order[-third:]
    difference = float(np.median(gains[dark]) - np.median(gains[bright]))
    if third < _FEWEST or difference > -_LIGHT_CHANGES:
        return None
    scene = median([relit(samples[k], lights[k], shape) for k in bright])
    seen = median([samples[k] for k in dark]).astype(np.float32)
    expected = median([relit(scene, inverse_light(lights[k]), shape) for k in dark])
    return np.asarray((seen - expected) / np.float32(difference), np.float32)
