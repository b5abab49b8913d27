"""A report is one safe page with every part; which way a score is better is what the scores do when
tracks get worse.
"""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from report_runs import run_record

from phdtrack.cli.evaluate import BY_TRAJECTORY
from phdtrack.metrics import evaluate
from phdtrack.metrics.causes import SUMS
from phdtrack.report import About, Recorder, report_html
from phdtrack.report.pages import environment, score_meanings
from phdtrack.types import SequenceInfo, Tracks, Truth

VOID = {"meta", "img", "br"}
EVIL = "<script>alert('x')</script>&\"<img src=x onerror=y>\x07"


class Page(HTMLParser):
    """Checks that tags close in order; collects tags, what stands for pictures and charts, and the
    visible text.
    """

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.images: list[str | None] = []
        self.words = ""
        self.feed(source)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            assert not name.startswith("on")
            assert name not in ("href", "srcset")
            if name == "src":
                assert value is not None
                assert value.startswith("data:image/")
        if tag == "img" or ("role", "img") in attrs:
            self.images.append(dict(attrs)["alt" if tag == "img" else "aria-label"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words += data


def offline(source: str) -> None:
    """No address of the network anywhere, also not inside the charts, save for the names of XML
    name spaces.
    """
    assert "image/svg+xml" not in source
    assert not re.search(
        r"https?:|//[a-z]+\.|@import|url\((?!#)", re.sub(r'xmlns(:\w+)?="[^"]*"', "", source)
    )


def test_report_is_one_offline_file_with_every_part() -> None:
    about = About(
        title="Walk",
        command="phdtrack track walk.mp4",
        seed=11,
        started="2025-01-01T00:00:00+00:00",
        seconds=100.0,
        versions=(("phdtrack", "9.8.7"),),
        scores=(("MOTA", 0.8125), ("id_switches", 3), ("GOSPA", float("nan"))),
        warnings=("The video ended early.",),
        notes=("An object is believed after 2 coherent detections.",),
    )
    source = report_html(run_record(24, 2, about=about), {"filter": {"p_detect": 0.95}})
    page = Page(source)
    offline(source)
    assert "script" not in page.tags
    assert len(page.images) == 5  # arrivals, where objects are, paths, lifetimes, count
    assert all(page.images)
    words = page.words.replace("\u00a0", " ")
    for expected in (
        "2 objects in 24 frames (2.3 s of video)",
        "About 25 % of 48 detections were rejected as false alarms: the filter judged that no",
        "The detector finds 67 % of the tracked objects in a frame; the other track boxes are",
        "Speed: 100.0 frames/s.",
        "1 min 40 s",
        "first seen",
        "heights a second",
        "0.812",
        "undefined",
        "The video ended early.",
        "2 coherent detections",
        "phdtrack track walk.mp4",
        "Seed 11",
        "phdtrack 9.8.7",
        "filter.p_detect",
        "0.95",
    ):
        assert expected in words, expected
    assert re.search(r"id_switches\s*3\D", words)


def test_what_an_analyst_needs_comes_first() -> None:
    source = report_html(run_record(24, 3), {})
    assert re.findall("<h2>(.*?)</h2>", source) == [
        "Objects over time",
        "Objects",
        "How long and how fast",
        "Where objects are",
        "Trajectories",
        "Track lifetimes",
        "Time per stage",
        "For researchers",
        "How to reproduce this",
    ]
    # The filter's count and evidence are folded.
    before, _, after = source.partition("For researchers")
    assert "Line chart over" not in before
    assert after.index("<details>") < after.index("Line chart over")


def test_every_chart_of_objects_names_its_table() -> None:
    words = Page(report_html(run_record(24, 3), {})).words
    for expected in (
        "minutes.csv has a row for each minute, hours.csv one for each hour",
        "objects.csv has a row for each object",
        "the column seconds of objects.csv",
        "the column speed_in_heights of objects.csv",
        "heatmap.csv has the number of boxes in each cell",
    ):
        assert expected in words, expected
    endless = Page(report_html(replace(run_record(24, 3), tables=False), {})).words
    assert ".csv" not in endless


def test_report_gives_one_share_of_false_alarms() -> None:
    words = Page(report_html(run_record(24, 2), {})).words.replace("\u00a0", " ")
    assert "25 %of detections rejected as false alarms" in words
    assert words.count("false alarm") == 2
    assert "12 of 48" not in words


def test_text_from_outside_is_escaped() -> None:
    pairs = ((EVIL, 0.5),)
    about = About(EVIL, EVIL, 0, EVIL, 0.0, ((EVIL, EVIL),), pairs, (EVIL,), (EVIL,))
    record = run_record(3, 1, about=about, info=SequenceInfo(40, 30, 5.0, name=EVIL))
    source = report_html(record, {EVIL: {"a": EVIL, "b": [EVIL]}})
    page = Page(source)
    assert "script" not in page.tags
    assert page.words.count("<script>alert") >= 8
    # Control characters, which no browser shows, become the sign for what cannot be shown.
    assert "\x07" not in page.words
    assert "\ufffd" in page.words


def test_an_empty_run_has_a_report() -> None:
    record = Recorder(SequenceInfo(64, 48, 25.0, name="nothing")).record(Tracks.empty(), About())
    source = report_html(record, {})
    page = Page(source)
    assert "No frame was processed." in page.words
    assert "No object was tracked." in page.words
    assert "0 objects in 0 frames." in page.words
    assert page.images == []


sizes = st.integers(1, 3000)


@settings(max_examples=4, deadline=None)
@given(
    st.integers(0, 30),
    st.integers(0, 6),
    sizes,
    sizes,
    st.floats(0, 60),
    st.booleans(),
    st.booleans(),
)
def test_report_of_any_run_is_well_formed(
    frames: int, objects: int, wide: int, high: int, fps: float, video: bool, truth: bool
) -> None:
    info = SequenceInfo(wide, high, fps)
    source = report_html(run_record(frames, objects, info=info, video=video, truth=truth), {})
    Page(source)
    offline(source)
    assert ("There were no detections." in source) == (objects == 0 < frames)


def test_filter_without_mass_has_a_report() -> None:
    record = run_record(4, 1)
    record.mass[:] = np.nan
    record.log_evidence[:] = np.nan
    source = report_html(replace(record, whole=record.whole._replace(false_alarms=0.0)), {})
    Page(source)
    assert "none of them rejected as a false alarm" in source
    assert "nan" not in re.sub(r'src="[^"]*"', "", source)


def test_evidence_has_a_chart_if_there_is_any() -> None:
    record = run_record(4, 1)
    assert "log evidence" not in report_html(record, {})
    record.log_evidence[:] = [-3, -2, np.nan, -1]
    assert "log evidence of each frame, -2.0 on average" in report_html(record, {})


def test_every_score_has_a_meaning() -> None:
    nobody = Truth(
        np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0, np.bool_)
    )
    assert {
        *evaluate(nobody, Tracks.empty()).as_dict(),
        *BY_TRAJECTORY,
        *SUMS,
        "log_evidence",
        "ms",
    } == set(score_meanings())


FRAMES = 20
PEOPLE = 3
# Neither way: numbers of what there is, and an error with a sign.
PLAIN = {
    "frames",
    "truth_boxes",
    "output_boxes",
    "truth_objects",
    "output_identities",
    "count_error_mean",
}


def walkers() -> Truth:
    frame, who = (grid.ravel() for grid in np.mgrid[1 : FRAMES + 1, 1 : PEOPLE + 1])
    corner = np.stack([5.0 * frame, 150.0 * who], axis=1)
    return Truth(
        frame, who, np.hstack([corner, corner + np.array([40, 80])]), np.zeros(len(frame), np.bool_)
    )


def tracks(frame: np.ndarray, identity: np.ndarray, xyxy: np.ndarray) -> Tracks:
    n = len(frame)
    return Tracks(frame, identity, xyxy, np.ones(n), np.zeros(n, np.int64), np.ones(n, np.bool_))


def worse(truth: Truth) -> dict[str, Tracks]:
    """The truth with one kind of mistake each."""
    frame = truth.frame
    who = truth.identity
    xyxy = truth.xyxy
    held = {
        "late": frame > 4,
        "never": who != 2,
        "gaps": (frame < 8) | (frame > 11) | (who == 3),
        "hardly": (who != 1) | (frame == 3),
    }
    out = {name: tracks(frame[rows], who[rows], xyxy[rows]) for name, rows in held.items()}
    out["shifted"] = tracks(frame, who, xyxy + 3)
    out["switched"] = tracks(frame, np.where(frame > 10, who % PEOPLE + 1, who), xyxy)
    out["nobody"] = tracks(
        np.tile(frame, 2),
        np.append(who, who + 10),
        np.vstack([xyxy, xyxy + np.array([300, 0, 300, 0])]),
    )
    return out


def test_stated_direction_of_every_score_is_right() -> None:
    truth = walkers()
    best = evaluate(truth, tracks(truth.frame, truth.identity, truth.xyxy)).as_dict()
    found = [evaluate(truth, each).as_dict() for each in worse(truth).values()]
    lower = {
        name for name, meaning in score_meanings().items() if meaning.endswith("; lower is better")
    }
    assert set(best) >= PLAIN
    for name in set(best) - PLAIN:
        sign = -1 if name in lower else 1
        changes = sign * np.array(
            [float(each[name]) - best[name] for each in found if each[name] is not None]
        )
        assert changes.max() <= 1e-12, name
        assert changes.min() < -1e-6, name


def test_a_table_folds_no_single_row() -> None:
    words = "{% import 'macros.html' as m %}{{ m.table(('a', 'b'), rows) }}"
    table = environment().from_string(words)
    shown = {n: table.render(rows=[(str(k), "b") for k in range(n)]) for n in (12, 13)}
    assert "more" not in shown[12]
    assert "3 more rows" in shown[13]
    assert shown[13].count('class="more"') == 3
