"""MATLAB files are read by SciPy in a separate process: any failure of it becomes an error."""

from __future__ import annotations

import io
import random
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from phdtrack.errors import InputError
from phdtrack.ground import MatrixForm, read_camera
from phdtrack.ground.matlab import read_matrices

FORM = MatrixForm(unit="cm", vectors="column")


def saved(folder: Path, content: bytes | None = None) -> Path:
    path = folder / "h.mat"
    file = io.BytesIO()
    savemat(
        file,
        {"h": np.array([[0.01, 0.002, -3], [0.0003, -0.02, 4], [1e-5, 2e-3, 1]])},
        do_compression=True,
    )
    path.write_bytes(file.getvalue() if content is None else content)
    return path


def test_crash_of_the_matlab_reader_is_an_error() -> None:
    with pytest.raises(InputError, match=r"SciPy cannot read \(it crashed\)"):
        read_matrices(b"MATLAB", reader="import os; os.abort()")


def test_hanging_matlab_reader_is_ended() -> None:
    with pytest.raises(InputError, match="SciPy cannot read"):
        read_matrices(b"MATLAB", reader="import time; time.sleep(60)", time_limit=0.2)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"MATLAB 7.3 MAT-file" + bytes(600), "7.3 .HDF5.*-v7"),
        (b"MATLAB 5.0 MAT-file" + bytes(600), "SciPy cannot read"),
        (b"no file of MATLAB", "SciPy cannot read"),
        (b"", "SciPy cannot read"),
    ],
)
def test_files_that_are_not_matlab_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_camera(saved(tmp_path, content), FORM)


@pytest.mark.slow
def test_damaged_matlab_files_are_read_or_refused(tmp_path: Path) -> None:
    whole = saved(tmp_path).read_bytes()
    rng = random.Random(1)
    read_camera(saved(tmp_path, whole), FORM)
    for _ in range(6):
        content = bytearray(whole)
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        for damaged in (bytes(content), whole[: rng.randrange(len(whole))]):
            with suppress(InputError):
                read_camera(saved(tmp_path, damaged), FORM)
