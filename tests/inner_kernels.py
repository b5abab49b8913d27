"""Kernels that only kernels call, made callable from Python: they are compiled without the wrapper
that this needs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config, njit


def from_python(*kernels: Any) -> list[Callable[..., Any]]:
    """The same kernels, with that wrapper."""
    return list(kernels) if config.DISABLE_JIT else [_wrapped(kernel) for kernel in kernels]


def _wrapped(kernel: Any) -> Callable[..., Any]:
    # Numba adds "nopython" to what it was given, and warns if it gets that back.
    options = {name: value for name, value in kernel.targetoptions.items() if name != "nopython"}
    wrapped: Callable[..., Any] = njit(**(options | {"no_cpython_wrapper": False}))(kernel.py_func)
    return wrapped
