"""Positions, read; errors name the line."""

import numpy as np
import pytest
from format_cases import put

from phdtrack.errors import InputError
from phdtrack.formats.columns import read_positions

LINE = "{} {} 1.5 0 2.5 0.1 0 -0.2\n"


def test_positions_are_sorted_and_lose_their_height(tmp_path):
    found = read_positions(put(tmp_path, LINE.format(786, 2) + LINE.format(780, 3) + LINE.format(786, 1)))
    assert found.frame.tolist() == [780, 786, 786]
    assert found.identity.tolist() == [3, 1, 2]
    assert found.state[:, 0].tolist() == [1.5, 2.5, 0.1, -0.2]
    assert found.at(786).identity.tolist() == [1, 2]
    assert len(found.at(781)) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", r"line 1: expected 8 columns, frame, identity.*came 3 numbers"),
        (LINE.format(1, 1) + LINE.format(1, 1), r"line 2: .*one twice"),
        (LINE.format(1, 1) + LINE.format(2.5, 1), r"line 2: .*whole number for the frame"),
        (LINE.format(1, 1) + "2 1 nan 0 0 0 0 0\n", r"line 2: .*finite"),
        (LINE.format(1, 1) + "2 1 x 0 0 0 0 0\n", r"line 2: .*number for the x"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_positions(put(tmp_path, text))


@pytest.mark.parametrize(("name", "people"), [("seq_eth", 360), ("zara01", 148)])
def test_the_annotated_sequences_are_whole(data, name, people):
    assert len(np.unique(read_positions(data / "groups" / name / "obsmat.txt").identity)) == people
