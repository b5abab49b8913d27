"""Camera motion as a file: reading, writing, and errors that name the line."""

import numpy as np
import pytest
from format_cases import put

from phdtrack.errors import InputError
from phdtrack.formats import WarpsWriter, read_warps

HEADER = "frame,g11,g12,g13,g21,g22,g23,g31,g32,g33"
TILTED = np.array([[1.01, 0.02, 5.5], [-0.03, 0.99, -2.25], [1e-5, -2e-5, 1.0]])


def test_written_file_is_read_back(tmp_path):
    with WarpsWriter(tmp_path / "camera.csv") as file:
        file.append(2, TILTED)
        file.append(5, np.eye(3))
    warps = read_warps(tmp_path / "camera.csv")
    np.testing.assert_array_equal(warps.frame, [2, 5])
    np.testing.assert_allclose(warps.matrix, [TILTED, np.eye(3)], rtol=1e-11)


@pytest.mark.parametrize("lines", [
    ("2,1,0,4,0,1,-3", "4,1,0,2,0,1,0"),
    ("4 1 0 2 0 1 0", "2 1 0 4 0 1 -3"),
    (HEADER, "2,2,0,8,0,2,-6,0,0,2", "4,1,0,2,0,1,0,0,0,1"),
    ("# by hand", "g23,g22,g21,g13,g12,g11,frame", "-3,1,0,4,0,1,2", "0,1,0,2,0,1,4"),
], ids=["affine", "blanks, unsorted", "scaled", "columns by name"])  # fmt: skip
def test_accepted_forms_of_a_warp_file(lines, tmp_path):
    warps = read_warps(put(tmp_path, "\n".join(lines)))
    np.testing.assert_array_equal(warps.frame, [2, 4])
    np.testing.assert_array_equal(warps.matrix[:, :2, 2], [[4, -3], [2, 0]])
    np.testing.assert_array_equal(warps.matrix[:, :2, :2], [np.eye(2)] * 2)


def test_warps_are_composed_over_several_frames(tmp_path):
    warps = read_warps(put(tmp_path, "2,1,0,4,0,1,-3\n3,2,0,0,0,2,0\n5,1,0,1,0,1,1"))
    np.testing.assert_array_equal(warps.between(1, 2), [[1, 0, 4], [0, 1, -3], [0, 0, 1]])
    np.testing.assert_array_equal(warps.between(1, 3), [[2, 0, 8], [0, 2, -6], [0, 0, 1]])
    np.testing.assert_array_equal(warps.between(2, 5), [[2, 0, 1], [0, 2, 1], [0, 0, 1]])
    for still in ((3, 4), (5, 9), (0, 1)):
        np.testing.assert_array_equal(warps.between(*still), np.eye(3))


def test_empty_warp_file_means_a_still_camera(tmp_path):
    assert len(read_warps(put(tmp_path, "# nothing")).frame) == 0
    assert (read_warps(put(tmp_path, HEADER)).between(1, 50) == np.eye(3)).all()


@pytest.mark.parametrize(("lines", "words"), [
    (("2,1,0,0,0,1",), "line 1: expected 7 or 10 columns, frame, g11.*; got 6 numbers"),
    (("2,1,0,0,0,1,0", "3,1,0,0,0,1"), "line 2: expected 7 values"),
    (("2,1,0,0,0,one,0",), "line 1: expected a number for the g22"),
    (("0,1,0,0,0,1,0",), "line 1: .*of 1 or more for the frame number, got 0"),
    (("nan,1,0,0,0,1,0",), "line 1: .*of 1 or more for the frame number, got nan"),
    (("2,1,0,0,0,1,0", "3,1,0,0,0,1,0", "2,1,0,0,0,1,0"), "line 3: frame 2 is given twice"),
    ((HEADER, "2,1,0,0,0,1,0,0,0,0"), "line 2: expected 3 x 3 or 2 x 3 finite numbers, the last"),
    ((HEADER, "2,-1,0,0,0,1,0,0,0,1"), "line 2: expected how a camera moves"),
    (("frame,a,b", "2,1,0"), "expected 7 or 10 columns, frame, g11.*; got frame, a, b"),
])  # fmt: skip
def test_errors_name_the_line(lines, words: str, tmp_path):
    with pytest.raises(InputError, match=words):
        read_warps(put(tmp_path, "\n".join(lines)))
