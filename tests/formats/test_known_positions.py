"""Positions on the ground: obsmat.txt of ETH and UCY, CSV with and without velocities, faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.formats.known_positions import read_positions


def written(folder: Path, text: str) -> Path:
    path = folder / "positions.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_obsmat_has_z_between_x_and_y(tmp_path: Path) -> None:
    text = " 10 2 1.5 0.0 2.5 0.1 0.0 -0.2\n 0 1 1.0 0.0 2.0 0.3 0.0 0.4\n"
    found = read_positions(written(tmp_path, text))
    np.testing.assert_array_equal(found.frame, [0, 10])
    np.testing.assert_array_equal(found.identity, [1, 2])
    np.testing.assert_array_equal(found.state, [[1, 1.5], [2, 2.5], [0.3, 0.1], [0.4, -0.2]])


@pytest.mark.parametrize(
    "text",
    [
        "frame,id,x,y,vx,vy\n1,5,1,2,3,4\n",
        "vy;vx;y;x;id;frame\n4;3;2;1;5;1\n",
        "1 5 1 2 3 4\n",
        "Frame,ID,X,Y,name,VX,VY\n1,5,1,2,7,3,4\n",
    ],
)
def test_columns_are_found_by_name_or_by_order(text: str, tmp_path: Path) -> None:
    found = read_positions(written(tmp_path, text))
    assert (found.frame[0], found.identity[0]) == (1, 5)
    np.testing.assert_array_equal(found.state[:, 0], [1, 2, 3, 4])


def test_velocities_may_be_missing(tmp_path: Path) -> None:
    found = read_positions(written(tmp_path, "frame,id,x,y\n1,1,0,0\n2,1,1,0\n"))
    assert len(found) == 2
    assert np.isnan(found.state[2:]).all()
    assert len(read_positions(written(tmp_path, ""))) == 0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "frame,id,left,top\n1,1,0,0\n",
            r"positions\.csv, line 2: expected positions in metres, got",
        ),
        ("1,2,3\n", "got 3 numbers a line"),
        ("1,1,0,0\n1,1,5,5\n", r"line 2: person 1 is twice in frame 1"),
        ("1.5,1,0,0\n", "expected a whole number of 0 or more for the frame, got 1.5"),
        ("1,1,nan,0\n", "expected a place in metres, got nan"),
        ("1,1,a,0\n", r"expected a number for the x \(column 3\), got 'a'"),
    ],
)
def test_a_fault_is_named_with_its_line(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        read_positions(written(tmp_path, text))
