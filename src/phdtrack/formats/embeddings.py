"""Embeddings of detections in a NumPy file: a row for each row of the file of detections, in the
order of that file.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, cannot_write, part_of, publish, refuse_part
from phdtrack.types import F4

Rows = NDArray[np.floating[Any]]


def open_embeddings(path: AnyPath, rows: int, detections: AnyPath) -> Rows:
    """(M, D) the embeddings in a file, which are read from disk when they are used.

    Parameters
    ----------
    path : the file, as `numpy.save` writes it.
    rows : M, number of rows of the file of detections.
    detections : that file, for messages.

    Raises
    ------
    InputError : the file is missing, is no such file, holds no numbers, or has another number of
        rows.
    """
    path = Path(path)
    refuse_part(path)
    cure = "Write it by numpy.save, an array (rows, length) of float16 or float32."
    try:
        embeddings = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise InputError("there is no such file", where=path) from None
    except OSError as error:
        problem = f"the file cannot be read: {error.strerror or error}"
        raise InputError(problem, where=path) from None
    except (ValueError, EOFError):
        raise InputError("expected a NumPy file of numbers", where=path, cure=cure) from None
    if not isinstance(embeddings, np.ndarray):
        raise InputError("expected one array, got an archive of arrays", where=path, cure=cure)
    if embeddings.ndim != 2 or embeddings.dtype.kind not in "fiu":
        got = f"{embeddings.shape} of {embeddings.dtype}"
        raise InputError(f"expected embeddings (rows, length), got {got}", where=path, cure=cure)
    if len(embeddings) != rows:
        raise InputError(
            f"expected {rows} rows, as {detections} has, got {len(embeddings)}",
            where=path,
            cure="Give a row for each row of the detections, in the order of that file.",
        )
    if rows and not embeddings.shape[1]:
        raise InputError("expected embeddings, got rows of no numbers", where=path)
    return embeddings


class EmbeddingsWriter:
    """Writes embeddings frame by frame, as `numpy.save` does all at once. The file's name ends in
    ``.part`` until it is closed.

    Detections without embeddings get zeros. ``close`` may be called twice. After a failed write the
    file keeps the name with ``.part``; it also keeps it if an error leaves the ``with`` block.
    Raises `InputError` if the file cannot be written.

    Parameters
    ----------
    path : the file.
    dtype : of the numbers in it.
    """

    def __init__(self, path: AnyPath, dtype: DTypeLike = np.float16) -> None:
        self.path = Path(path)
        self._dtype = np.dtype(dtype)
        self._rows = 0
        # Rows of zeros that wait until the length is known.
        self._waiting = 0
        self._length = 0
        self._whole = True
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = part_of(self.path).open("wb", buffering=0)
            self._write_header()
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def append(self, embeddings: F4 | None, count: int) -> None:
        """Write the embeddings of ``count`` detections; None if they have none."""
        if not self._whole:
            return
        if embeddings is not None and not self._length:
            self._length = embeddings.shape[1]
        if not self._length:
            self._waiting += count
            return
        rows = np.zeros((self._waiting + count, self._length), self._dtype)
        if embeddings is not None and count:
            rows[self._waiting :] = embeddings
        self._waiting = 0
        try:
            left = memoryview(rows.tobytes())
            while left:
                left = left[self._file.write(left) :]
            self._rows += len(rows)
        except OSError as error:
            self._whole = False
            with suppress(OSError):
                self._write_header()
            raise cannot_write(self.path, error) from None

    def close(self) -> None:
        """Complete the file and give it its final name."""
        if self._file.closed:
            return
        try:
            if self._whole:
                self._rows += self._waiting
                self._write_header()
            self._file.close()
            if self._whole:
                publish(self.path)
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._whole = self._whole and kind is None
        self.close()

    def _write_header(self) -> None:
        """Write the header for the rows so far. NumPy leaves room in it for any number of rows."""
        self._file.seek(0)
        np.lib.format.write_array_header_1_0(
            self._file,
            {
                "descr": np.lib.format.dtype_to_descr(self._dtype),
                "fortran_order": False,
                "shape": (self._rows, self._length),
            },
        )
