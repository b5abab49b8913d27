"""Numba leaves: arrays and numbers in, arrays out. They import numpy and numba only, and keep no state.

Each has a naive twin in ``tests/reference`` and a test that compares the two on random inputs, with the JIT on and off.
All are compiled on first use and cached on disk (see `cache`).
"""

import numpy as np

from phdtrack.kernels.cache import prepare

prepare()

# The C library gives the memory of large arrays back to the system when they are freed, and has to fetch and clear it again
# in the next frame: a third of a filter's time at a thousand targets. It keeps as much as twice the largest block that was
# ever freed, so that a block of 8 MB, made and freed once and never touched, ends this.
np.empty(1 << 20)
