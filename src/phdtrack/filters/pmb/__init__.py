"""The Poisson multi-Bernoulli filter."""

from phdtrack.filters.pmb.filter import PMB

__all__ = ["PMB"]
