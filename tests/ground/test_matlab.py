"""The reader of MATLAB files against SciPy's, and files that are broken, or claim what is not there."""

import io
import random
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from phdtrack.errors import InputError
from phdtrack.ground.matlab import read_matlab
from phdtrack.ground.read import read_camera

KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
NAMES = st.text("abcdefgh", min_size=1, max_size=8)


def array(kind: str, shape: list[int], start: int) -> np.ndarray:
    return (start + 7 * np.arange(int(np.prod(shape))) % 100).astype(kind).reshape(shape)


ARRAYS = st.builds(array, st.sampled_from(KINDS), st.lists(st.integers(0, 4), min_size=2, max_size=3), st.integers(0, 20))
TEXTS = st.text("abc ä€", min_size=1, max_size=9).filter(lambda text: text.strip() == text)
VALUES = st.recursive(
    ARRAYS | TEXTS,
    lambda inner: st.dictionaries(NAMES, inner, min_size=1, max_size=3) | st.lists(inner, min_size=1, max_size=3),
    max_leaves=4,
)


def saved(value: dict[str, Any], *, packed: bool = False) -> bytes:
    def ready(one: Any) -> Any:
        if isinstance(one, dict):
            return {name: ready(inner) for name, inner in one.items()}
        if isinstance(one, list):
            cell = np.empty((1, len(one)), object)
            cell[0, :] = [ready(inner) for inner in one]
            return cell
        return one

    file = io.BytesIO()
    savemat(file, ready(value), do_compression=packed)
    return file.getvalue()


def same(ours: Any, theirs: Any) -> None:
    """SciPy's structs are arrays of one record, its cells arrays of objects, its texts arrays of one."""
    if isinstance(ours, dict):
        assert list(ours) == list(theirs.dtype.names)
        for name, value in ours.items():
            same(value, theirs[name][0, 0])
    elif isinstance(ours, list):
        assert len(ours) == theirs.size
        for value, other in zip(ours, theirs.ravel(order="F"), strict=True):
            same(value, other)
    elif isinstance(ours, str):
        assert [ours] == theirs.tolist()
    else:
        assert ours.dtype == np.float64
        np.testing.assert_array_equal(ours, theirs.astype(np.float64))


@given(st.dictionaries(NAMES, VALUES, min_size=1, max_size=3), st.booleans())
@settings(max_examples=60, deadline=None)
def test_it_reads_what_scipy_reads(value: dict[str, Any], packed: bool) -> None:
    content = saved(value, packed=packed)
    theirs = loadmat(io.BytesIO(content))
    ours = read_matlab(content)
    assert list(ours) == list(value)
    for name, one in ours.items():
        same(one, theirs[name])


def element(order: str, kind: int, data: bytes) -> bytes:
    return struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8)


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders_and_short_elements(order: str) -> None:
    """A name of up to four bytes stands in the place of the size."""
    numbers = struct.pack(f"{order}9d", *range(9))
    short = struct.pack(f"{order}I", 1 << 16 | 1) + b"h\0\0\0"
    parts = element(order, 6, struct.pack(f"{order}II", 6, 0)) + element(order, 5, struct.pack(f"{order}ii", 3, 3))
    head = b"MATLAB 5.0".ljust(124) + struct.pack(f"{order}H", 0x0100) + {"<": b"IM", ">": b"MI"}[order]
    content = head + element(order, 14, parts + short + element(order, 9, numbers))
    np.testing.assert_array_equal(read_matlab(content)["h"], np.arange(9.0).reshape(3, 3).T)
    np.testing.assert_array_equal(read_matlab(content)["h"], loadmat(io.BytesIO(content))["h"])


def test_what_no_camera_needs_is_passed_over() -> None:
    from scipy.sparse import csc_array

    content = saved({"a": np.array([[1 + 2j]]), "b": np.array([[True]]), "c": csc_array(np.eye(3)), "d": np.eye(2)})
    found = read_matlab(content)
    np.testing.assert_array_equal(found.pop("d"), np.eye(2))
    assert set(found) <= {"a", "b", "c"}
    assert all(value is None for value in found.values())


def test_the_camera_of_caviar(data: Path) -> None:
    content = (data / "caviar" / "caviar_homography.mat").read_bytes()
    ours, theirs = read_matlab(content), loadmat(io.BytesIO(content))
    for name in ("c2b", "f2b"):
        np.testing.assert_array_equal(ours[name]["tdata"]["T"], theirs[name]["tdata"][0, 0]["T"][0, 0])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"MATLAB 7.3 MAT-file".ljust(600), r"7\.3 \(HDF5\)"),
        (b"\x89HDF\r\n\x1a\n" + bytes(600), r"7\.3 \(HDF5\)"),
        (struct.pack("<5I", 0, 3, 3, 0, 2) + b"h\0" + bytes(72), "version 4"),
        (b"", "version 4"),
    ],
)
def test_other_versions_get_a_sentence(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "h.mat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_camera(path)
    assert caught.value.where == str(path)
    assert "-v7" in caught.value.cure


def claims(kind: int, shape: tuple[int, ...], rest: bytes = b"") -> bytes:
    """A variable that says it is as large as this, with next to nothing in it."""
    flags, size = element("<", 6, struct.pack("<II", kind, 0)), element("<", 5, struct.pack(f"<{len(shape)}i", *shape))
    return saved({})[:128] + element("<", 14, flags + size + element("<", 1, b"h") + rest)


@pytest.mark.parametrize(
    "content",
    [
        claims(1, (2**31 - 1, 2**31 - 1)),
        claims(2, (2**31 - 1, 9), element("<", 5, struct.pack("<i", 4)) + element("<", 1, b"abc\0")),
        claims(2, (1, 1), element("<", 5, struct.pack("<i", 0)) + element("<", 1, b"abc\0")),
        claims(6, (2**31 - 1, 2**31 - 1), element("<", 9, bytes(8))),
        claims(6, (-1, 3), element("<", 9, bytes(8))),
        claims(6, (3, 3), element("<", 77, bytes(72))),
        claims(6, (3, 3), element("<", 9, bytes(71))),
        saved({})[:128] + element("<", 14, element("<", 6, struct.pack("<II", 6, 0))),
        saved({})[:128] + element("<", 15, zlib.compress(bytes(1 << 27), 9)),
        saved({})[:128] + element("<", 15, b"no zlib"),
        saved({})[:128] + struct.pack("<II", 14, 2**32 - 1),
    ],
)
def test_claims_are_not_believed(content: bytes) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_matlab(content)


def test_cells_within_cells_end() -> None:
    content = b""
    for _ in range(100):
        parts = element("<", 6, struct.pack("<II", 1, 0)) + element("<", 5, struct.pack("<ii", 1, 1)) + element("<", 1, b"h")
        content = element("<", 14, parts + content)
    with pytest.raises(InputError, match="deeper"):
        read_matlab(saved({})[:128] + content)


@pytest.mark.parametrize("packed", [False, True])
def test_every_cut_and_many_flips_are_read_or_refused(packed: bool) -> None:
    """SciPy's reader dies of one in some thousands."""
    content = saved({"c2b": {"tdata": {"T": np.eye(3)}, "names": ["a", "bc"]}}, packed=packed)
    draw = random.Random(5)
    broken = [content[:end] for end in range(128, len(content))]
    for _ in range(2000):
        flipped = bytearray(content)
        flipped[draw.randrange(124, len(content))] ^= 1 << draw.randrange(8)
        broken.append(bytes(flipped))
    outcomes = set()
    for one in broken:
        try:
            read_matlab(one)
            outcomes.add("read")
        except InputError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}
