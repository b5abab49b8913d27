"""Means over kinds of scenes, and settings chosen without the kind on which they are judged."""

import pytest

from experiments.video_kinds import VIDEOS, chosen_elsewhere, mean_of_kinds

KINDS = ["street", "street", "street", "indoor"]


def test_many_videos_of_one_kind_count_as_one_kind() -> None:
    assert mean_of_kinds(KINDS, [0.0, 0.0, 0.3, 0.9]) == pytest.approx(0.5)


def test_a_setting_is_chosen_on_the_other_kinds() -> None:
    values = {"low": [0.9, 0.9, 0.9, 0.1], "high": [0.2, 0.2, 0.2, 0.8]}
    mean, choices = chosen_elsewhere(KINDS, values)
    assert choices == {"street": "high", "indoor": "low"}
    assert mean == pytest.approx((0.2 + 0.1) / 2)


def test_each_kind_can_be_left_out() -> None:
    kinds = {video.kind for video in VIDEOS}
    assert len(kinds) >= 5
    assert len({video.name for video in VIDEOS}) == len(VIDEOS)
