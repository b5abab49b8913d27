"""The mass of γ that newborn particles stand for, by uniform draws over the regions they come
from.
"""

from __future__ import annotations

import math

import numpy as np

REGION = 13.276704135987622
"""The 99 % quantile of χ² with four degrees of freedom."""


def uniform_in_regions(z, sigma, count, rng):
    """Points uniform over each 99 % region: (4, N·count), the volume of each point's region, the
    regions that hold it.
    """
    n = z.shape[1]
    direction = rng.normal(size=(4, n * count))
    radius = math.sqrt(REGION) * rng.random(n * count) ** 0.25
    owner = np.repeat(np.arange(n), count)
    points = z[:, owner] + sigma[:, owner] * direction / np.linalg.norm(direction, axis=0) * radius
    volume = math.pi**2 / 2 * REGION**2 * sigma.prod(0)
    distance2 = (((points[:, :, None] - z[:, None, :]) / sigma[:, None, :]) ** 2).sum(0)
    return points, volume[owner], (distance2 <= REGION * (1 + 1e-12)).sum(1)


def image_density(points, rate, frame):
    inside = (points[2:] > 0).all(0)
    return inside * rate / (frame[0] * frame[1]) ** 2


def local_density(points, own, rate):
    """Of births that are as dense as at the detections ``own`` (4, n), in whose regions the points
    lie.
    """
    return (points[2:] > 0).all(0) * rate / (4 * (own[2] * own[3]) ** 2)


def mass(z, sigma, density, count, rng):
    """∫ over the union of the regions of ``density``, a function of points and of the detections
    whose regions hold them.
    """
    points, volume, held = uniform_in_regions(z, sigma, count, rng)
    return float((density(points, np.repeat(z, count, axis=1)) * volume / held).sum() / count)


def in_neighbourhood(x, z):
    """Whether the boxes x = (px, py, w, h) lie in the neighbourhood of z, elementwise over
    columns.
    """
    near = (np.abs(x[0] - z[0]) <= z[2]) & (np.abs(x[1] - z[1]) <= z[3])
    return near & (np.abs(x[2] - z[2]) <= z[2] / 2) & (np.abs(x[3] - z[3]) <= z[3] / 2)
