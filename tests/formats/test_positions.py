"""Positions and annotated groups, read; errors name the line."""

import numpy as np
import pytest
from format_cases import put

from phdtrack.errors import InputError
from phdtrack.formats.positions import read_groups, read_positions

LINE = "{} {} 1.5 0 2.5 0.1 0 -0.2\n"


def test_positions_are_sorted_and_lose_their_height(tmp_path):
    found = read_positions(put(tmp_path, LINE.format(786, 2) + LINE.format(780, 3) + LINE.format(786, 1)))
    assert found.frame.tolist() == [780, 786, 786]
    assert found.identity.tolist() == [3, 1, 2]
    assert found.state[:, 0].tolist() == [1.5, 2.5, 0.1, -0.2]
    assert found.at(786).identity.tolist() == [1, 2]
    assert len(found.at(781)) == 0


@pytest.mark.parametrize(
    ("reader", "text", "message"),
    [
        (read_positions, "1 2 3\n", r"line 1: expected 8 columns .*came 3"),
        (read_positions, LINE.format(1, 1) + LINE.format(1, 1), r"line 2: .*came one twice"),
        (read_positions, LINE.format(1, 1) + LINE.format(2.5, 1), r"line 2: .*whole number for the frame"),
        (read_positions, LINE.format(1, 1) + "2 1 nan 0 0 0 0 0\n", r"line 2: .*finite"),
        (read_positions, LINE.format(1, 1) + "2 1 x 0 0 0 0 0\n", r"line 2: .*number for the x"),
        (read_groups, "1 2\n3 b\n", r"line 2: .*'b'"),
    ],
)
def test_errors_name_the_line(tmp_path, reader, text, message):
    with pytest.raises(InputError, match=message):
        reader(put(tmp_path, text))


def test_groups_are_lines_of_identities_and_lines_that_share_people_are_one_group(tmp_path):
    assert read_groups(put(tmp_path, "1 2\n\n 13 11 12 \n")) == ((1, 2), (11, 12, 13))
    assert read_groups(put(tmp_path, "1 2\n3 4\n5 6\n4 1\n7 7\n")) == ((1, 2, 3, 4), (5, 6), (7,))


# Of seq_eth's 61 lines some share people.
@pytest.mark.parametrize(("name", "people", "groups"), [("seq_eth", 360, 58), ("zara01", 148, 45)])
def test_the_annotated_sequences_are_whole(data, name, people, groups):
    folder = data / "groups" / name
    positions = read_positions(folder / "obsmat.txt")
    assert len(np.unique(positions.identity)) == people
    found = read_groups(folder / "groups.txt")
    assert len(found) == groups
    assert set().union(*found) <= set(positions.identity.tolist())
