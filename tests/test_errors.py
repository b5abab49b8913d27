"""Bounds stated in annotations are kept by every record of settings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.config.registry import SECTIONS, record
from phdtrack.errors import (
    Count,
    InputError,
    NonNegative,
    Positive,
    PositiveCount,
    Probability,
    Share,
    bounds,
    check,
)


@dataclass(frozen=True)
class Bounded:
    """One field of each kind, and one without bounds."""

    probability: Probability = 0.5
    share: Share = 0.5
    positive: Positive = 1.0
    non_negative: NonNegative = 0.0
    count: Count = 0
    positive_count: PositiveCount = 1
    free: object = None

    def __post_init__(self) -> None:
        check(self)


@pytest.mark.parametrize(("name", "value"), [
    ("probability", -1e-9), ("probability", 1 + 1e-9),
    ("share", 0), ("share", 1.5),
    ("positive", 0.0), ("positive", -1),
    ("non_negative", -1e-300),
    ("count", -1),
    ("positive_count", 0),
])  # fmt: skip
def test_what_is_out_of_bounds_is_told(name: str, value: float):
    with pytest.raises(InputError, match=f"Bounded.{name}: expected a value .*, got"):
        Bounded(**{name: value})


@pytest.mark.parametrize("name", [name for name, _ in bounds(Bounded)])
@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, "1", None, True, [1.0], np.array([0.5])], ids=repr
)
def test_what_is_no_number_is_told(name: str, value: object):
    with pytest.raises(InputError, match=f"Bounded.{name}: expected a number"):
        Bounded(**{name: value})


@given(
    st.floats(0, 1, exclude_min=True), st.floats(0, 1e300, exclude_min=True), st.integers(1, 10**9)
)
def test_what_is_within_bounds_passes(share: float, positive: float, count: int):
    for number in (float, np.float64):
        Bounded(
            number(share), number(share), number(positive), number(positive), count, np.int64(count)
        )
    Bounded(0, 1, 1, 0, 0, 1, free="anything")


def test_every_record_of_settings_keeps_its_bounds():
    """Also where it is made by hand, without configuration: NaN is refused in every field that has
    bounds.
    """
    needed = {
        "frame_size": (640.0, 480.0),
        "boxes": [(0.0, 0.0, 1.0, 1.0)],
        "places": [],
        "file": "births.json",
    }
    for settings in {
        record(section, kind) for section, kinds in SECTIONS.items() for kind in kinds
    }:
        given_ = {
            key: value for key, value in needed.items() if key in settings.__dataclass_fields__
        }
        settings(**given_)
        for name, _ in bounds(settings):
            with pytest.raises(InputError, match=f"{name}: expected a number"):
                settings(**given_, **{name: math.nan})


def test_long_error_is_truncated_and_masks_secrets():
    """Were each character the beginning of an address or of a parameter, this would take days."""
    for piece in ("a.", "?", "&", "a://", "?key", "x=&"):
        assert len(str(InputError(piece * 1_000_000, where="f"))) < 4000
    said = str(InputError("x" * 100_000 + " rtsp://me:word@host/?quality=1&Token=abc&n=2"))
    assert "word" not in said
    assert "abc" not in said
    assert said.endswith("rtsp://…@host/?quality=1&Token=…&n=2")
    for user in (
        "me:word",
        "me:a?word",
        "me:a#word",
        "me:/a?word",
        "me:" + 200 * "word",
    ):
        assert (
            str(InputError(f"no answer of RTSP://{user}@host/1")) == "no answer of RTSP://…@host/1"
        )
    for address, masked in (
        ("rtsp://cam.lan/stream@1", "rtsp://cam.lan/…"),
        # A host and its port, or a user and the begin of a password.
        ("RTSP://me:12/word@host/1", "RTSP://…"),
        ("rtsp://10.0.0.5:554/user=admin@ch1", "rtsp://10.0.0.5:554/user=…"),
    ):
        assert str(InputError(address)) == masked
