"""Corrected tracks when everything is known: pieces of one target joined, and all rows smoothed."""

from phdtrack.smooth.smoothing import Smoothing

__all__ = ["Smoothing"]
