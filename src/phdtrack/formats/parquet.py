"""Parquet: a table with the same names of columns as a CSV file with a header. Needs pyarrow, which is imported on use."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.columns import Kind, by_name
from phdtrack.formats.rows import Rows
from phdtrack.formats.source import Origin
from phdtrack.formats.table import assemble
from phdtrack.formats.text import normalise


def rows_of_parquet(path: Path, content: bytes, kind: Kind, first: int) -> Rows:
    """The boxes in a Parquet file; ``first`` is the number that it gives the first frame.

    Raises
    ------
    InputError : pyarrow is not installed, the file is no Parquet, or a column is missing or holds no numbers.
    """
    try:
        import pyarrow as arrow
        import pyarrow.parquet as parquet
    except ImportError:
        cure = "Install it: pip install 'phdtrack[parquet]'."
        raise InputError(
            "reading Parquet needs the package pyarrow, which is not installed", where=path, cure=cure
        ) from None
    try:
        file = parquet.ParquetFile(arrow.BufferReader(content))
        names = [str(name) for name in file.schema_arrow.names]
        if len(set(names)) < len(names):
            raise InputError("expected columns of different names, came two of the same", where=path)
        layout = by_name(kind, [normalise(name) for name in names], path)
        table = file.read(columns=[names[c] for c in layout.columns])
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:  # a broken footer can be any of them
        raise InputError(f"expected a Parquet file, which cannot be read: {error}", where=path) from None
    absent = [c for c in layout.optional if table[names[c]].null_count == len(table)]
    layout = layout.without(absent)
    origin = Origin(path, "row", np.arange(1, len(table) + 1))
    values = np.empty((len(table), len(layout.columns)))
    for i, c in enumerate(layout.columns):
        try:
            column = table[names[c]].cast(arrow.float64())
        except arrow.ArrowException:
            problem = f"expected numbers in the column {names[c]}, came {table[names[c]].type}"
            raise InputError(problem, where=path, cure="Convert it before it is written.") from None
        values[:, i] = column.fill_null(np.nan).to_numpy()
    return assemble(origin, layout, values, first)
