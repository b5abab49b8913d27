"""Matrices in MATLAB files of versions 4 to 7.

A damaged file can make SciPy's reader crash or take all memory: it runs in a process of its own
with a memory limit.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8

# Prints the 3 x 3 matrices and transforms (`maketform`) of a MATLAB file by name.
_READER = """
import io, json, sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (1 << 32, 1 << 32))
except ImportError:
    pass
from scipy.io import loadmat

def matrix(value):
    if isinstance(value, dict):
        inner = value.get("tdata", value)
        return matrix(inner.get("T")) if isinstance(inner, dict) else None
    good = getattr(value, "shape", None) == (3, 3) and value.dtype.kind in "fiu"
    return value.astype(float).tolist() if good else None

held = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
matrices = {name: matrix(value) for name, value in held.items()}
print(json.dumps({name: rows for name, rows in matrices.items() if rows is not None}))
"""


def is_matlab(content: bytes) -> bool:
    """True if the content begins like a MATLAB file of any version."""
    return content.startswith((b"MATLAB", b"\x89HDF"))


def read_matrices(
    content: bytes, *, reader: str = _READER, time_limit: float = 60.0
) -> dict[str, F8]:
    """The 3 x 3 matrices and transforms in a MATLAB file, by name. Raises `InputError` if SciPy
    cannot read it.

    Parameters
    ----------
    content : the bytes of the file.
    reader : the Python program that prints the matrices of its standard input as JSON.
    time_limit : seconds until it is ended.
    """
    if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise InputError(
            "expected a file of MATLAB 4 to 7, got one of version 7.3 (HDF5)",
            cure="Save it with -v7.",
        )
    try:
        done = subprocess.run(
            # -P: nothing is imported from the current folder.
            [sys.executable, "-P", "-c", reader],
            input=content,
            capture_output=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            timeout=time_limit,
            check=True,
        )
    except subprocess.SubprocessError as error:
        lines = (
            (getattr(error, "stderr", None) or b"").decode(errors="replace").strip().splitlines()
        )
        reason = lines[-1] if lines else "it crashed"
        raise InputError(
            f"expected a file of MATLAB 4 to 7, which SciPy cannot read ({reason})",
            cure="Is it complete? Save it again, with -v7.",
        ) from None
    return {name: np.array(rows, np.float64) for name, rows in json.loads(done.stdout).items()}
