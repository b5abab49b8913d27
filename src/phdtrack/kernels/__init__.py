"""Numba leaves: arrays and numbers in, arrays out. They import numpy and numba only, and keep no state.

Each has a naive twin in ``tests/reference`` and a test that compares the two on random inputs, with the JIT on and off.
All are compiled on first use and cached on disk (see `cache`).
"""

from phdtrack.kernels.cache import Cache, prepare

CACHE: Cache = prepare()
"""Where this process keeps compiled kernels."""
