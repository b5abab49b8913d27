"""What the page asks for and what is answered, to whom, and what every answer carries."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from page_cases import FRAMES, SIZE, session
from starlette.testclient import TestClient

from phdtrack.clock import Clock
from phdtrack.label import DRAWN, LabelStore
from phdtrack.label.label_page import label_app
from phdtrack.types import Detections, DetectionTable
from phdtrack.web.endpoints import MAX_BODY

HOST = "127.0.0.1:8000"


@pytest.fixture
def app(tmp_path):
    return label_app(session(tmp_path / "labels.sqlite", 12))


@pytest.fixture
def page(app):
    return TestClient(app)


def marks(*boxes, frame=1, mark="false"):
    return {"marks": [{"frame": frame, "box": box, "mark": mark} for box in boxes]}


def test_frames_and_their_boxes(page):
    overview = page.get("/api/overview").json()
    assert (overview["width"], overview["height"], len(overview["frames"])) == (*SIZE, FRAMES)
    frame = page.get("/api/frame/3").json()
    assert len(frame["boxes"]) == 13
    assert frame["boxes"][0][4] == 0.5
    assert (frame["marks"], frame["undo"], frame["redo"]) == ({}, 0, 0)


def test_marks_are_kept_undone_and_redone(page):
    page.post("/api/frame/1/marks", json=marks(12) | {"who": "other"})
    answer = page.post("/api/frame/1/marks", json=marks(0, 12) | {"who": "me", "key": "k"}).json()
    assert answer["marks"] == {"0": "false", "12": "false"}
    assert answer["progress"]["false"] == 2
    assert (answer["undo"], answer["redo"]) == (1, 0)
    # What somebody else did stays.
    answer = page.post("/api/frame/1/undo", json={"who": "me"}).json()
    assert (answer["marks"], answer["by"], answer["undo"], answer["redo"]) == (
        {"12": "false"},
        {"12": "other"},
        0,
        1,
    )
    assert page.get("/api/frame/1?who=other").json()["undo"] == 1
    assert page.post("/api/frame/1/redo", json={"who": "me"}).json()["progress"]["false"] == 2
    assert page.post("/api/frame/1/done", json={"done": True}).json()["progress"]["done"] == 1
    header, *rows = page.get("/api/labels.csv").text.split()
    assert header == "frame,box,mark,left,top,right,bottom,labeller"
    assert rows == ["1,0,false,20.0,20.0,140.0,140.0,me", "1,12,false,50.0,50.0,95.0,95.0,me"]
    assert page.get("/api/labels.json").json()["annotations"][0]["attributes"]["labeller"] == "me"
    assert page.get("/api/labels.xml").text.startswith("<?xml")


def test_all_like_one_leaves_out_what_is_marked(page):
    assert page.get("/api/frame/1/alike/12").json() == [
        [number, 12] for number in range(1, FRAMES + 1)
    ]
    page.post("/api/frame/5/marks", json=marks(12, frame=5))
    assert [5, 12] not in page.get("/api/frame/1/alike/12").json()


def learned_map(page):
    """Whether anything was learned, and how red the map is."""
    answer = page.get("/api/map/false").json()
    data = base64.b64decode(answer["picture"].removeprefix("data:image/png;base64,"))
    return (
        answer["learned"],
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[..., 3],
    )


def test_the_map_shows_where_false_boxes_were_marked(page):
    learned, shown = learned_map(page)
    assert (learned, shown.max()) == (False, 0)
    page.post(
        "/api/frame/1/marks",
        json={"marks": [{"frame": k, "box": 0, "mark": "false"} for k in range(1, 21)]},
    )
    learned, shown = learned_map(page)
    assert learned
    assert shown.max() > 150
    # The box's centre, at half the size; the far corner stays clear.
    down, across = np.unravel_index(np.argmax(shown), shown.shape)
    box = page.get("/api/frame/1").json()["boxes"][0]
    assert (2 * across, 2 * down) == pytest.approx(
        ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), abs=6
    )
    assert shown[-40:, -40:].max() == 0


def test_a_map_of_marks_that_lie_anywhere_says_so_and_is_clear(tmp_path):
    made = session(tmp_path / "labels.sqlite", 12)
    rng = np.random.default_rng(0)
    centre = rng.uniform(20, np.array(SIZE) - 20, (100, 2))
    half = rng.uniform(18, 22, (100, 2))
    detections = Detections.of(np.hstack([centre - half, centre + half]), np.full(100, 0.5))
    page = TestClient(
        label_app(replace(made, table=DetectionTable(np.ones(100, np.int64), detections)))
    )
    page.post("/api/frame/1/marks", json=marks(*range(100)))
    learned, shown = learned_map(page)
    assert (learned, shown.max()) == (False, 0)
    # Ten are too few to tell: a density that is fitted to them alone would show one place.
    page.post("/api/frame/1/undo", json={})
    page.post("/api/frame/1/marks", json=marks(*range(10)))
    assert learned_map(page)[0] is False


@pytest.mark.parametrize(
    ("path", "sent", "words"),
    [
        ("marks", marks(0, mark="perhaps"), "'false', 'birth', 'true' or 'none'"),
        ("marks", marks(13), "13 detections, and no number 13"),
        ("marks", marks(-1), "no number -1"),
        ("marks", marks(0, mark="true"), "the place of box 0, got none"),
        (
            "marks",
            {"marks": [{"frame": 1, "box": DRAWN, "mark": "true", "place": [3, 3, 3, 9]}]},
            "left < right",
        ),
        ("marks", marks(0, frame=77), "frame 77 is not one"),
        ("marks", {"marks": ["x"]}, "marks.0: "),
        ("marks", {"marks": []}, "a mark or more"),
        ("marks", marks(0) | {"key": "x" * 200}, "key: String should have at most 100"),
        ("undo", [1], "an object"),
    ],
)
def test_unusable_input_is_refused_and_changes_nothing(page, path, sent, words):
    answer = page.post(f"/api/frame/1/{path}", json=sent)
    assert answer.status_code == 400
    assert words in answer.json()["error"]
    assert page.get("/api/overview").json()["progress"]["false"] == 0


def test_suggestions_leave_out_what_is_marked(page):
    found = page.get("/api/suggestions").json()
    assert (found["ready"], found["share"], found["problem"], found["more"]) == (True, 1.0, "", 0)
    assert len(found["items"]) == FRAMES + FRAMES // 2
    assert found["items"][0] == [1, 3, "place", 0.99, 0]
    assert found["items"][FRAMES] == [1, 4, "rejected", 0.95, -1]
    page.post(
        "/api/frame/1/marks",
        json={"marks": [{"frame": k, "box": 3, "mark": "false"} for k in (1, 2)]},
    )
    assert len(page.get("/api/suggestions").json()["items"]) == FRAMES + FRAMES // 2 - 2
    page.post("/api/frame/1/undo", json={})
    assert len(page.get("/api/suggestions").json()["items"]) == FRAMES + FRAMES // 2


def test_a_clip_is_played_by_the_times_of_its_frames(tmp_path):
    """A video of 25 frames a second that pauses for a second and a half behind frame 22."""
    made = session(tmp_path / "labels.sqlite", 12)
    store = LabelStore.open(tmp_path / "few.sqlite", "drawn", "digest", [1, 20])
    seconds = np.arange(FRAMES) / 25
    seconds[22:] += 1.5
    clock = Clock(np.arange(1, FRAMES + 1), seconds, 25.0)
    page = TestClient(label_app(replace(made, store=store, clock=clock)))
    first, other = page.get("/api/overview").json()["frames"]
    assert first["seconds"] == [0.04] * 11
    assert other["seconds"] == [0.04] * 12 + [1.54] + [0.04] * 8


def test_frames_of_a_clip_are_answered_and_marked(tmp_path):
    made = session(tmp_path / "labels.sqlite", 12)
    store = LabelStore.open(tmp_path / "few.sqlite", "drawn", "digest", [20])
    # A frame of a clip is kept small: its boxes are those of the whole frame all the same.
    small = np.zeros((SIZE[1] // 4, SIZE[0] // 4, 3), np.uint8)
    left, top, right, bottom = (round(v / 4) for v in made.table.at(25).xyxy[0])
    small[top:bottom, left:right] = 255
    stills = {**made.stills, 25: cv2.imencode(".jpg", small)[1].tobytes()}
    page = TestClient(label_app(replace(made, store=store, stills=stills)))
    assert page.get("/api/overview").json()["frames"] == [
        {"number": 20, "done": False, "clip": [10, 30], "seconds": [0.04] * 21}
    ]
    assert len(page.get("/api/frame/25").json()["boxes"]) == 13
    crop = cv2.imdecode(np.frombuffer(page.get("/crop/25/0.jpg").content, np.uint8), 0)
    assert (crop > 128).mean() == pytest.approx(1 / 1.4**2, abs=0.08)
    assert page.get("/api/frame/31").status_code == 400
    assert (
        page.post("/api/frame/20/marks", json=marks(0, frame=25, mark="birth")).status_code == 200
    )
    assert (
        page.post("/api/frame/20/marks", json=marks(0, frame=31, mark="birth")).status_code == 400
    )


HUGE = b'{"marks": [' + b'{"frame": 1, "box": 0, "mark": "false"},' * 10_001 + b"]}"


@pytest.mark.parametrize("body", [
    b'{"marks": ' + b"[" * 100_000,
    b'{"marks": [{"frame": 1' + b"0" * 5000 + b', "box": 0, "mark": "false"}]}',
    b'{"marks": [{"frame": 1, "box": 1e400, "mark": "false"}]}',
    b'{"marks": [{"frame": null, "box": [], "mark": {}}]}',
    b'{"who": "\xff\xfe", "marks": []}',
    b'{"who": "\\ud800", "marks": [{"frame": 1, "box": 0, "mark": "none"}]}',
    b"\xff" * 1000,
    HUGE,
], ids=range(8))  # fmt: skip
def test_a_malformed_body_is_refused(page, body: bytes):
    assert page.post("/api/frame/1/marks", content=body).status_code == 400
    assert page.get("/api/overview").json()["progress"]["false"] == 0


def test_a_long_body_is_refused(page):
    parts = (b" " * 2**16 for _ in range(MAX_BODY // 2**16 + 1))
    assert page.post("/api/frame/1/marks", content=parts).status_code == 413
    assert page.post("/api/frame/1/marks", content=b" " * MAX_BODY).status_code == 400


@pytest.mark.parametrize("what", ["marks", "undo", "redo", "done"])
@pytest.mark.parametrize("number", ["9" * 30, "9" * 400, "0", "41"])
def test_an_unknown_frame_cannot_be_changed(page, what: str, number: str):
    assert page.post(f"/api/frame/{number}/{what}", json={}).status_code == 400


def test_the_number_of_marks_is_limited(page):
    one = {"frame": 1, "box": 0, "mark": "none"}
    answer = page.post("/api/frame/1/marks", json={"marks": [one] * 10_001})
    assert (answer.status_code, "at most 10000" in answer.text) == (400, True)
    answer = page.post("/api/frame/1/marks", json={"marks": [one] * 10_000})
    assert answer.status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/static/../page.py", "/static/%2e%2e/page.py", "/static/..%2f..%2fpyproject.toml",
        "/still/../../etc/passwd", "/static//etc/passwd", "/etc/passwd", "/still/99999.jpg",
        "/crop/1/777.jpg", "/api/frame/99999", "/api/frame/-1", "/api/frame/1.5", "/static/%00",
        "/api/map/walls", "/static/%ff%fe",
    ],
)  # fmt: skip
def test_nothing_else_can_be_read(page, path):
    answer = page.get(path)
    assert answer.status_code in (400, 404)
    assert b"root:" not in answer.content
    assert b"import" not in answer.content
