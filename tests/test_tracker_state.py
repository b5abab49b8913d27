"""Checkpoints of the tracker: what is saved, how it goes on from there, and what is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.errors import InputError
from phdtrack.filters import NoFilter
from phdtrack.types import SequenceInfo
from tracker_cases import PARTICLES, SIZE, boxes, equal, feed, street, tracker_of


@pytest.fixture(scope="module")
def scene():
    """Frames of detections with clutter."""
    return street()


LEARN = {"learn": {"kind": "online", "memory": 0.05, "verdict_delay": 0.3}}
DELAY = {"associate": {"output_delay": 3}}
PREVIOUS = {"sensor": {"scaling": "previous"}}
RATES = {"rates": {"kind": "learned", "detection": True, "clutter": True}}


@pytest.mark.parametrize("section", [
    {}, DELAY, PREVIOUS, LEARN, RATES, {"merged_measurements": {"kind": "explained"}},
    {"preset": "default"}, {"preset": "default", **LEARN},
    *({"filter": {"kind": kind}} for kind in ("none", "gm-phd", "gm-cphd", "particle-cphd")),
    {"filter": {"kind": "mht"}, **DELAY},
    {"filter": {"kind": "mcmc", "samples": 50, "min_weight": 0.01}},
    *({"filter": PARTICLES, **more} for more in ({}, DELAY, PREVIOUS, LEARN)),
], ids=str)  # fmt: skip
def test_a_resumed_run_is_bit_identical(section, scene):
    whole, first, second = (tracker_of(**section) for _ in range(3))
    wanted = feed(whole, scene)
    feed(first, scene[:35])
    saved = pickle.dumps(first.state_dict())
    feed(first, scene[5:30])
    second.update(boxes(0))
    second.load_state_dict(pickle.loads(saved))
    rest = feed(second, scene[35:])
    assert all(equal(x, y) for x, y in zip(rest, wanted[35:], strict=True))
    assert equal(second.tracks(), whole.tracks())
    assert equal(second.flush(), whole.flush())
    assert second.rates == whole.rates
    assert (whole.rates is None) == ("rates" not in section)


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_a_saved_state_may_be_used_twice_and_written_into(kind: str, scene):
    tracker = tracker_of(filter={"kind": kind})
    feed(tracker, scene[:20])
    saved = tracker.state_dict()
    results = []
    for _ in range(2):
        other = tracker_of(filter={"kind": kind})
        other.load_state_dict(saved)
        results.append(feed(other, scene[20:30]))
    assert all(equal(a, b) for a, b in zip(*results, strict=True))
    overwrite(saved)
    assert all(equal(a, b) for a, b in zip(feed(tracker, scene[20:30]), results[0], strict=True))


def overwrite(value) -> None:
    """Every array within set to 0."""
    if isinstance(value, np.ndarray):
        value[...] = 0
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        overwrite(item)


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_a_saved_state_holds_plain_values_only(kind: str, scene):
    tracker = tracker_of(filter={"kind": kind})
    feed(tracker, scene[:10])

    def check(value):
        if isinstance(value, dict):
            for key, item in value.items():
                assert isinstance(key, str)
                check(item)
        elif isinstance(value, list):
            for item in value:
                check(item)
        else:
            assert value is None or type(value) in (bool, int, float, str, np.ndarray, np.float64), type(value)

    check(tracker.state_dict())


def test_the_state_of_an_earlier_version_is_told():
    with pytest.raises(InputError, match=r"^load_state_dict: this state is of format 1, .* reads format 19"):
        tracker_of().load_state_dict(tracker_of().state_dict() | {"format": 1})


def state(**changed) -> dict:
    """What a damaged file may hold instead of the state."""
    return {"state": {"record": "phdtrack.pipeline:TrackingState", "fields": {}} | changed}


@pytest.mark.parametrize("changed", [
    None, [], {}, {"format": 99}, {"left_out": 3}, {"state": 3},
    state(record="phdtrack.associate.history:History"), state(record="os.system"),
    state(fields=[]), state(fields={"number": 3}),
], ids=str)  # fmt: skip
def test_what_is_no_saved_state_is_told_and_changes_nothing(changed):
    tracker, plain = tracker_of(), tracker_of()
    for k in range(10):
        tracker.update(boxes(k))
        plain.update(boxes(k))
    with pytest.raises(InputError, match="load_state_dict"):
        tracker.load_state_dict(tracker.state_dict() | changed if changed else changed)
    saved = tracker.state_dict()
    saved["state"][0]["values"][0][1]["fields"]["intensity"] = {"record": "Mystery", "fields": {}}
    with pytest.raises(InputError, match="load_state_dict"):
        tracker.load_state_dict(saved)
    assert equal(tracker.update(boxes(10)), plain.update(boxes(10)))


@pytest.mark.parametrize("filter_", ["pmb", "particle-phd", "gm-phd", "gm-cphd", "mht", "mcmc"])
def test_a_state_of_other_settings_is_told(filter_: str):
    saved, other = (tracker_of(filter={"kind": filter_}, sensor={"scaling": s}) for s in ("previous", "particle"))
    saved.update(boxes(0))
    with pytest.raises(InputError, match=r"expected states of 6 components, got 8"):
        other.load_state_dict(saved.state_dict())


def test_a_state_of_ones_own_that_cannot_be_saved_is_told():
    class Odd:
        """A state that no checkpoint knows."""

        mass = 0.0

    class OddFilter(NoFilter):
        def start(self, model, rng):
            return Odd()

    made = config.build(config.load(), SequenceInfo(*SIZE, 25.0))
    with pytest.raises(InputError, match="Odd"):
        Tracker(stages=replace(made, filter=OddFilter())).state_dict()
