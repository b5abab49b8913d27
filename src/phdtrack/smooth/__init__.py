"""Finished tracks refined: pieces of one trajectory joined, and all of them smoothed, with everything known at the end.

An associator links states as they come, with the filter's states as they were then. `Smoothing` begins again with what was
measured: tracklets' ends meet (`stitch`, with `evidence` of one object against two), and every row is the state given all
measurements of its track, before and after (`smooth`).
"""

from phdtrack.smooth.smoothing import Smoothing

__all__ = ["Smoothing"]
