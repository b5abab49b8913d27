"""Checkpoints of the tracker: what is saved, how it goes on from there, and what is refused."""

from __future__ import annotations

import json
import pickle
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.errors import InputError
from phdtrack.filters import NoFilter
from phdtrack.state import from_bytes, to_bytes
from phdtrack.types import Detections, SequenceInfo
from tracker_cases import PARTICLES, SIZE, boxes, equal, feed, street, tracker_of


@pytest.fixture(scope="module")
def scene():
    """Frames of detections with clutter."""
    return street()


DELAY = {"associate": {"output_delay": 3}}


@pytest.mark.parametrize("section", [
    {}, DELAY, {"merged_measurements": {"kind": "explained"}},
    {"preset": "default"},
    *({"filter": {"kind": kind}} for kind in ("none", "gm-phd", "gm-cphd", "particle-cphd")),
    {"filter": {"kind": "mht"}, **DELAY},
    {"filter": {"kind": "mcmc", "samples": 50, "min_weight": 0.01}},
    *({"filter": PARTICLES, **more} for more in ({}, DELAY)),
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
    for item in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    ):
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
            assert value is None or type(value) in (
                bool,
                int,
                float,
                str,
                np.ndarray,
                np.float64,
            ), type(value)

    check(tracker.state_dict())


def test_the_state_of_an_earlier_version_is_told():
    with pytest.raises(
        InputError, match=r"^load_state_dict: this state is of format 1, .* reads format 21"
    ):
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
    tracker = tracker_of()
    plain = tracker_of()
    for k in range(10):
        tracker.update(boxes(k))
        plain.update(boxes(k))
    with pytest.raises(InputError, match="load_state_dict"):
        tracker.load_state_dict(tracker.state_dict() | changed if changed else changed)
    saved = tracker.state_dict()
    saved["lanes"][0]["fields"]["state"]["fields"]["intensity"] = {
        "record": "Mystery",
        "fields": {},
    }
    with pytest.raises(InputError, match="load_state_dict"):
        tracker.load_state_dict(saved)
    assert equal(tracker.update(boxes(10)), plain.update(boxes(10)))


@pytest.mark.parametrize("filter_", ["pmb", "particle-phd", "gm-phd", "gm-cphd", "mht", "mcmc"])
def test_a_state_of_other_settings_is_told(filter_: str):
    saved, other = (
        tracker_of(filter={"kind": filter_}, motion={"kind": kind}) for kind in ("point", "box")
    )
    saved.update(boxes(0))
    with pytest.raises(InputError, match=r"expected states of 6 components, got 4"):
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


# What is damaged


FILTERS = (
    "pmb",
    "pmbm",
    "mht",
    "gm-phd",
    "gm-cphd",
    "particle-phd",
    "particle-cphd",
    "mcmc",
    "none",
)


def arrays(value, way: tuple = ()):
    """The ways to all arrays within that have elements."""
    if isinstance(value, np.ndarray):
        if value.size:
            yield way
        return
    for key, one in (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    ):
        yield from arrays(one, (*way, key))


def at(value, way: tuple):
    for key in way:
        value = value[key]
    return value


def put(value, way: tuple, new):
    """A copy with another value there."""
    if not way:
        return new
    out = value.copy()
    out[way[0]] = put(value[way[0]], way[1:], new)
    return out


def few(kind: str) -> dict:
    return {"filter": {"kind": kind, **({"samples": 20, "burn_in": 2} if kind == "mcmc" else {})}}


@pytest.mark.parametrize("kind", FILTERS)
def test_a_shortened_array_is_refused_or_does_no_harm(kind: str, scene):
    """It was a segmentation fault in the next update."""
    tracker = tracker_of(**few(kind))
    feed(tracker, scene[:6])
    saved = tracker.state_dict()
    ways = list(arrays(saved))
    chosen = np.random.default_rng(1).permutation(len(ways))[:20]
    refused = []
    for k in chosen:
        try:
            tracker.load_state_dict(put(saved, ways[k], at(saved, ways[k])[:-1]))
            feed(tracker, scene[6:8])
            tracker.tracks()
        except InputError as error:
            refused.append(str(error))
    assert len(refused) > 0.8 * len(chosen)
    assert all(text.startswith("load_state_dict, ") for text in refused)


LANE = ("lanes", 0, "fields")
STATE = (*LANE, "state", "fields")
LAYER = (*STATE, "intensity", "fields", "layers", -1, "fields")
MIXTURE = (*STATE, "intensity", "fields")
LINKS = (*STATE, "association", "fields")
LEARNED = (*STATE, "learned", "fields")
MOMENT = (*LINKS, "recent", -1, "fields")


def element(value, place=0, column: str = ""):
    """What puts a value into an array."""

    def change(array: np.ndarray) -> np.ndarray:
        out = array.copy()
        (out[column] if column else out).reshape(-1)[place] = value
        return out

    return change


@pytest.mark.parametrize(("section", "way", "change", "says"), [
    ({}, (*LAYER, "targets"), element(10**9, 0, "end"), "targets: expected numbers from 0"),
    ({}, (*LAYER, "targets"), element(0, 0, "end"), "layers.* do not fit each other"),
    ({}, (*LAYER, "hypotheses"), element(10**6, 0, "parent"), "intensity: .* do not fit each other"),
    ({}, (*LAYER, "hypotheses"), element(99, 0, "motion"), "do not fit each other"),
    ({}, (*LAYER, "hypotheses"), element(10**12, 0, "detection"), "do not fit each other"),
    ({}, (*LAYER, "mean"), element(np.nan), "mean: expected numbers from -1e"),
    ({}, (*LAYER, "covariance"), element(-1.0), "covariance: .* variances above 0"),
    (few("gm-phd"), (*MIXTURE, "covariance"), element(1e9, 9), "covariance: expected .* covariances"),
    (few("gm-phd"), (*MIXTURE, "covariance"), lambda a: a + 1e9 * (1 - np.eye(a.shape[1])), "covariance: .* covariances"),
    ({}, (*LAYER, "mean"), lambda a: a[:, :5], r"expected an array of shape \(C, d\)"),
    ({}, (*LAYER, "mean"), lambda a: a.astype(">f8"), "expected an array of float64, got >f8"),
    ({}, (*MOMENT, "estimates", "fields", "tag"), lambda a: a * 0, "do not fit each other"),
    ({}, (*MOMENT, "estimates", "record"), lambda a: np.zeros(2), "expected a Estimates"),
    ({}, (*MOMENT, "number"), lambda a: -1, "number: expected numbers from 1"),
    ({}, (*MOMENT, "z"), lambda a: a[:0], r"expected an array of shape \(m, N\)"),
    ({}, (*LINKS, "history", "fields", "forgotten"), lambda a: 1 << 31, "History do not fit"),
    ({}, (*LINKS, "time"), lambda a: 5e-324, "LabelledState do not fit"),
    (few("gm-phd"), (*LINKS, "time"), lambda a: 5e-324, "GraphState do not fit"),
    (few("particle-cphd"), (*MIXTURE, "intensity", "fields", "unit"), lambda a: 0.0, "Cardinalised do not fit"),
    (few("particle-cphd"), (*MIXTURE, "cardinality"), element(-1e-9, -1), "Cardinalised do not fit"),
    ({}, ("state", "fields", "past", 1, 1), lambda a: -1e300, "past|do not fit"),
    ({}, (*LANE, "seed", "fields", "increment"), lambda a: 2, "Seed do not fit"),
    ({}, (*LANE, "seed", "fields", "word"), lambda a: 1 << 40, "word: expected numbers from 0"),
    ({}, ("left_out", "fields", "left_out", "fields", "empty"), lambda a: "", "expected int, got str"),
    ({}, ("dim",), lambda a: np.zeros(3), "expected states of 6"),
    ({}, ("frame_size",), lambda a: np.zeros(3), "expected a state of frames of 640x480"),
    ({}, ("frame_size",), lambda a: "1920x1080", "expected a state of frames of 640x480, got one of '1920x1080'"),
    ({}, ("format",), lambda a: np.zeros(3), "no state of a tracker"),
    (few("gm-phd"), (*MIXTURE, "weight"), element(-0.5), "weight: expected numbers from 0"),
    (few("gm-phd"), (*LINKS, "window", "fields", "previous"), element(10**6), "GraphState do not fit"),
    (few("gm-phd"), (*LINKS, "window", "fields", "start"), element(10**6, -1), "start: expected numbers from 0"),
    (few("gm-phd"), (*LINKS, "given", "fields", "track"), lambda a: a[:-1], "GraphState do not fit"),
    (few("particle-phd"), (*MIXTURE, "start"), element(5), "start: .* ascending|do not fit"),
    (few("particle-phd"), (*MIXTURE, "state"), lambda a: a.astype(np.float64), "do not fit"),
    (few("mht"), (*LAYER, "parent"), element(10**6), "Hypotheses do not fit"),
    (few("mht"), (*MIXTURE, "lone"), lambda a: np.array([10**6]), "Hypotheses do not fit"),
    (few("mht"), (*MIXTURE, "lone"), lambda a: a[1:], "Hypotheses do not fit"),
    ({}, (*LEARNED, "alone"), lambda a: [0.0, 0.0], "ScoresSeen do not fit"),
    ({}, (*STATE, "camera", "fields", "scale"), element(0.0), "scale: expected numbers from 0.01"),
])  # fmt: skip
def test_what_is_damaged_is_named_and_changes_nothing(section, way, change, says, scene):
    section = section | ({"preset": "default"} if section == {} else {})
    tracker = tracker_of(**section)
    feed(tracker, scene[:6])
    saved = tracker.state_dict()
    number = tracker.state.number
    with pytest.raises(InputError, match=f"^load_state_dict.*({says})"):
        tracker.load_state_dict(put(saved, way, change(at(saved, way))))
    assert tracker.state.number == number
    tracker.load_state_dict(saved)


def test_a_whole_number_is_a_number(scene):
    """Kernels could not be compiled for it."""
    tracker = tracker_of(preset="default")
    feed(tracker, scene[:6])
    saved = tracker.state_dict()
    tracker.load_state_dict(put(saved, (*LEARNED, "extent"), [0, 1]))
    assert tracker.state.learned.extent == (0.0, 1.0)
    feed(tracker, scene[6:8])


@pytest.mark.parametrize(
    "value", [{"array": []}, {"array": [[], [3]]}, {"tuple": 3}, {"dict": []}, {}]
)
def test_a_block_of_which_nothing_can_be_made_is_refused(value):
    head = json.dumps(value).encode()
    content = struct.pack("<I", len(head)) + head
    with pytest.raises(InputError, match="cut off or changed"):
        from_bytes(struct.pack("<II", len(content), zlib.crc32(content)) + content)


@pytest.mark.parametrize("kind", ["08", "f8,f8", "O", "U3", "V8", 3, [["a", "O"]], [["a"]]])
def test_a_block_holds_arrays_of_numbers_only(kind):
    """Texts of types are not given to anything that reads programs."""
    block = to_bytes(np.arange(3.0)).replace(b'"<f8"', json.dumps(kind).encode())
    content = block[8:]
    head = content.index(b"}") + 1
    content = struct.pack("<I", head - 4) + content[4:]
    with pytest.raises(InputError, match="cut off or changed"):
        from_bytes(struct.pack("<II", len(content), zlib.crc32(content)) + content)


def test_a_state_as_bytes_is_the_same(scene):
    for kind in ("pmb", "mht"):
        tracker = tracker_of(filter={"kind": kind})
        other = tracker_of(filter={"kind": kind})
        feed(tracker, scene[:8])
        other.load_state_dict(from_bytes(to_bytes(tracker.state_dict())))
        assert equal(tracker.update(scene[8]), other.update(scene[8]))


# What is remembered


def test_memory_is_bounded_unless_everything_is_asked_for(caplog, monkeypatch):
    """A frame a second, and one minute instead of ten."""
    assert tracker_of().stages.associator.history == 600
    monkeypatch.setattr("phdtrack.tracker.HISTORY", 60.0)
    given = {"fps": 1.0, "filter": {"kind": "none"}, "time": {"longest_interval": 0.0}}
    bounded, whole = (tracker_of(**given, **more) for more in ({}, {"associate": {"history": 0}}))
    sizes = []
    for k in range(400):
        # Somebody comes every 20 seconds.
        found = boxes(k % 20) if k % 20 < 16 else np.zeros((0, 4))
        bounded.update(found)
        if k < 100:
            whole.update(found)
        if k in (199, 299, 399):
            sizes.append(len(to_bytes(bounded.state_dict())))
    assert max(sizes) < 1.5 * min(sizes), "but for the 32 frames that are forgotten at once"
    assert 280 < bounded.tracks().frame.min() <= 341
    assert whole.tracks().frame.min() < 10
    said = [record.getMessage() for record in caplog.records if "forgotten" in record.getMessage()]
    assert len(said) == 1
    assert "associate={'history': 0}" in said[0]


def test_what_is_kept_of_classes_is_forgotten_too():
    tracker = tracker_of(fps=5.0, associate={"history": 4.0})
    for k in range(150):
        tracker.update(Detections.of(boxes(k % 40), class_id=[1, 2]))
    lanes = tracker.snapshot()()["lanes"]
    assert all(len(lane["fields"]["rows"]["keys"]) < 100 for lane in lanes)


def test_identities_can_be_left_out():
    tracker = tracker_of()
    tracker.skip_identities(40)
    for k in range(10):
        rows = tracker.update(boxes(k))
    assert set(rows.identity) == {41, 42}
    assert tracker.highest == 42
