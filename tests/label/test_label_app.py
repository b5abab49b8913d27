"""What the page asks for and what is answered, to whom, and what every answer carries."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from page_cases import FRAMES, SIZE, session
from starlette.testclient import TestClient

from phdtrack.errors import InputError
from phdtrack.label import DRAWN, LabelStore
from phdtrack.label.label_page import label_app
from phdtrack.live.serving import COOKIE, POLICY, Guard, listen
from phdtrack.types import Detections, DetectionTable

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
def test_what_cannot_be_used_is_told_and_changes_nothing(page, path, sent, words):
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
        {"number": 20, "done": False, "clip": [10, 30]}
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


def client(app, token=""):
    return TestClient(Guard(app, frozenset({HOST}), token), base_url=f"http://{HOST}")


def test_answers_carry_the_policy_and_are_not_stored(app):
    answer = client(app).get("/")
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"] == POLICY
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-store"
    assert "unsafe" not in POLICY
    assert "http" not in POLICY


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1:9999", "localhost.evil.example:8000", ""]
)
def test_other_names_of_this_server_are_refused(app, host):
    assert client(app).get("/api/overview", headers={"host": host}).status_code == 421


def test_other_sites_change_nothing(app):
    inside = client(app)
    marks = {"marks": [{"frame": 1, "box": 0, "mark": "false"}]}
    assert inside.post("/api/frame/1/marks", json=marks).status_code == 403
    origin = {"origin": "http://evil.example", "x-phdtrack": "1"}
    assert inside.post("/api/frame/1/marks", json=marks, headers=origin).status_code == 403
    assert inside.get("/api/overview", headers={"origin": "null"}).status_code == 403
    assert inside.get("/api/overview").json()["progress"]["false"] == 0
    own = {"origin": f"http://{HOST}", "x-phdtrack": "1"}
    assert inside.post("/api/frame/1/marks", json=marks, headers=own).status_code == 200
    assert inside.get("/api/overview").json()["progress"]["false"] == 1


def test_with_a_token_nobody_enters_without(app):
    outside = client(app, token="secret")
    for path in ("/", "/api/overview", "/still/1.jpg", "/static/label.js"):
        assert outside.get(path).status_code == 401
    assert outside.get("/?token=wrong").status_code == 401
    assert COOKIE not in outside.cookies
    first = outside.get("/?token=secret")
    assert first.status_code == 200
    assert "HttpOnly" in first.headers["set-cookie"]
    assert outside.get("/api/overview").status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/static/../page.py", "/static/%2e%2e/page.py", "/static/..%2f..%2fpyproject.toml", "/still/../../etc/passwd",
        "/static//etc/passwd", "/etc/passwd", "/still/99999.jpg", "/crop/1/777.jpg", "/api/frame/99999",
    ],
)  # fmt: skip
def test_nothing_else_can_be_read(app, path):
    answer = client(app).get(path)
    assert answer.status_code in (400, 404)
    assert b"root:" not in answer.content
    assert b"import" not in answer.content


def test_an_address_beyond_this_machine_needs_a_token():
    for host, needed in (("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)):
        address = listen(host)
        with pytest.raises(InputError, match="cannot listen on"):
            listen(host, address.listening.getsockname()[1])
        address.listening.close()
        assert bool(address.token) is needed
        assert ("token=" in address.url) is needed
