"""Kernels without a wrapper for callers in Python end the process when Python calls them: nothing
but kernels has them.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module

import numpy as np
import pytest
from numba import config
from numba.core.registry import CPUDispatcher

import phdtrack
from inner_kernels import from_python
from phdtrack.kernels import fast32

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


def inner_kernels_of(module_name: str) -> set[str]:
    """Names under which a module has kernels without that wrapper."""
    names = vars(import_module(module_name)).items()
    return {
        name
        for name, value in names
        if isinstance(value, CPUDispatcher) and not callable_from_python(value)
    }


def callable_from_python(kernel: CPUDispatcher) -> bool:
    return not kernel.targetoptions.get("no_cpython_wrapper", False)


def test_only_kernels_import_inner_kernels() -> None:
    modules = {module.name for module in pkgutil.walk_packages(phdtrack.__path__, "phdtrack.")}
    outside = {
        name
        for name in modules
        if not name.startswith("phdtrack.kernels.") and not name.endswith("__main__")
    }
    assert len(outside) > 50
    assert {name: found for name in sorted(outside) if (found := inner_kernels_of(name))} == {}


def test_cached_kernels_can_be_called_from_python() -> None:
    modules = [
        module.name
        for module in pkgutil.iter_modules(phdtrack.kernels.__path__, "phdtrack.kernels.")
    ]
    inner = [
        vars(import_module(module))[name] for module in modules for name in inner_kernels_of(module)
    ]
    assert [kernel.py_func for kernel in inner if kernel.stats.cache_path is not None] == []


def test_from_python_wraps_inner_kernels() -> None:
    assert "exp32" in inner_kernels_of("phdtrack.kernels.fast32")
    [exp32] = from_python(fast32.exp32)
    assert exp32(np.float32(0.0)) == pytest.approx(1.0, abs=1e-6)
