"""Files for the tests of reading, and errors with the place that they name."""

from collections.abc import Callable
from pathlib import Path

import pytest

from phdtrack.errors import InputError


def put(folder: Path, content: str | bytes, name: str = "det.txt") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(reader: Callable[[Path], object], path: Path, where: str, words: str) -> None:
    """The reader raises an error that names the place (the path and what follows it) and the
    problem.
    """
    with pytest.raises(InputError) as caught:
        reader(path)
    assert caught.value.where == f"{path}{where}"
    assert words in caught.value.problem
