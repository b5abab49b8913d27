"""phdtrack: multi-target tracking in video with the Probability Hypothesis Density filter."""

from phdtrack._version import __version__

__all__ = ["__version__"]
