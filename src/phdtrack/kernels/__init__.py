"""Numba leaves: arrays and numbers in, arrays out. They import numpy and numba only, and keep no
state.

Each has a naive twin in ``tests/reference`` and a test that compares the two on random inputs, with
the JIT on and off. All are compiled on first use and cached on disk (see `cache`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import prepare

prepare()

U1 = NDArray[np.uint8]
U4 = NDArray[np.uint32]
U8 = NDArray[np.uint64]
I2 = NDArray[np.int16]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Bool = NDArray[np.bool_]
Real = NDArray[np.floating[Any]]
Records = NDArray[np.void]

# The C library gives the memory of large arrays back to the system when they are freed, and has to
# fetch and clear it again in the next frame: a third of a filter's time at a thousand targets. It
# keeps as much as twice the largest block that was ever freed, so that a block of 8 MB, made and
# freed once and never touched, ends this.
np.empty(1 << 20)
