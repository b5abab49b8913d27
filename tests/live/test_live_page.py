"""The page of live cameras: what it answers, and how it works in a real browser, on a desktop and
on a phone.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_server import CameraServer, Scripted, until, walker
from starlette.testclient import TestClient

from browsers import faults, needs_browser
from phdtrack.config import build_classes, load
from phdtrack.detect import make_detector
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.live_page import METRICS, live_app
from phdtrack.live.zones import Place, read_places, write_places
from phdtrack.types import Detections, SequenceInfo
from phdtrack.video import open_source
from phdtrack.video.live_sources import LiveSource

DOOR = Place('the "door"', ((80.0, 119.0), (80.0, 0.0)), closed=False)
ROOM = Place(
    "room",
    ((0.0, 0.0), (100.0, 0.0), (100.0, 119.0)),
    closed=True,
    anchor="centre",
    classes=("person",),
)


@pytest.fixture(scope="module")
def server() -> Iterator[CameraServer]:
    server = CameraServer()
    server.draw = walker
    yield server
    server.kill()


@pytest.fixture(scope="module")
def camera(server: CameraServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Camera]:
    folder = tmp_path_factory.mktemp("live")
    write_places(folder / "places.toml", (DOOR, ROOM))

    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(
            make_detector("change", min_area=0.005), build_classes(load(preset="mot15"), info), info
        )

    one = Camera(
        "gate",
        LiveSource(server.url),
        make,
        CameraSettings(folder, folder / "places.toml", video=0, blur="boxes"),
    )
    one.start()
    until(lambda: one.counted["cross"] >= 2)
    yield one
    one.stop(10.0)


def test_pictures_videos_and_maps_are_blurred(tmp_path: Path) -> None:
    """A chequered square that is detected; what the page serves and the video holds is as fine as a
    cell only.
    """
    block = np.kron([[0, 255], [255, 0]], np.ones((2, 2), np.uint8))

    def chequered(wall: float) -> np.ndarray:
        image = np.full((120, 160, 3), 120, np.uint8)
        image[30:94, 40:104] = np.tile(block, (16, 16))[..., None]
        return image

    def make(info: SequenceInfo) -> CameraParts:
        found = Detections.of(np.array([[40.0, 30, 104, 94]]))
        return CameraParts(lambda frame: found, build_classes(load(preset="mot15"), info), info)

    def rough(data: bytes) -> float:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        scale = image.shape[1] / 160
        inside = image[
            round(40 * scale) : round(88 * scale), round(48 * scale) : round(96 * scale)
        ].astype(float)
        return float(np.abs(np.diff(inside, axis=1)).mean() * scale)

    server = CameraServer()
    server.draw = chequered
    for blur in ("", "boxes"):
        folder = tmp_path / (blur or "plain")
        one = Camera(
            "gate", LiveSource(server.url), make, CameraSettings(folder, video=5.0, blur=blur)
        )
        page = TestClient(live_app([one]))
        one.start()
        until(lambda page=page: page.get("/picture/gate.jpg").content)
        shown = [page.get("/picture/gate.jpg").content, page.get("/map/gate/people.jpg").content]
        until(lambda one=one: one.frames > 20)
        assert one.stop(30.0)
        for video in (folder / "video").glob("*.mp4"):
            shown += [
                cv2.imencode(".png", frame.image)[1].tobytes() for frame in open_source(video)
            ]
        assert len(shown) > 3
        values = [rough(data) for data in shown]
        assert max(values) < 12 if blur else min(values) > 25, values
    server.kill()


@pytest.fixture
def page(camera: Camera) -> TestClient:
    return TestClient(live_app([camera]))


def test_it_shows_pictures_states_counts_and_events(page: TestClient, camera: Camera) -> None:
    assert page.get("/api/cameras").json() == [
        {"name": "gate", "state": "live", "tracks": camera.tracks}
    ]
    known = page.get("/api/camera/gate").json()
    assert (known["width"], known["height"], known["state"], known["problems"]) == (
        160,
        120,
        "live",
        [],
    )
    door, room = known["places"]
    assert (door["name"], door["kind"], room["kind"], room["anchor"], room["classes"]) == (
        'the "door"', "line", "zone", "centre", ["person"],
    )  # fmt: skip
    assert door["entered"] + door["left"] >= 2
    assert known["events"][-1]["kind"] == "appear"
    assert page.get("/api/camera/gate/minutes").json()[-1][2] >= 1
    first = page.get("/picture/gate.jpg")
    assert (first.status_code, first.content[:2]) == (200, b"\xff\xd8")
    second = page.get(f"/picture/gate.jpg?after={first.headers['x-frame']}")
    assert int(second.headers["x-frame"]) > int(first.headers["x-frame"])
    for what in ("people", "clutter"):
        assert page.get(f"/map/gate/{what}.jpg").content[:2] == b"\xff\xd8"
    assert 'src="/static/live.js"' in page.get("/").text


def test_prometheus_can_read_the_numbers(page: TestClient, camera: Camera) -> None:
    lines = page.get("/metrics").text.splitlines()
    assert 'phdtrack_source_up{camera="gate"} 1' in lines
    assert any(
        line.startswith('phdtrack_place_left_total{camera="gate",place="the \\"door\\""} ')
        for line in lines
    )
    assert any(
        line.startswith('phdtrack_events_total{camera="gate",kind="cross"} ') for line in lines
    )
    assert {line.split()[2] for line in lines if line.startswith("# TYPE")} == {
        f"phdtrack_{name}" for name in METRICS
    }
    for line in lines:
        if not line.startswith("#"):
            float(line.rpartition(" ")[2])


def test_boxes_that_were_not_used_are_counted(tmp_path: Path) -> None:
    def make(info: SequenceInfo) -> CameraParts:
        found = Detections.of(np.array([[40.0, 30, 64, 94], [90, 30, 114, 94], [5, 5, 5, 5]]))
        return CameraParts(
            lambda frame: found, build_classes(load(None, ["limits.max_detections=1"]), info), info
        )

    one = Camera("gate", source := Scripted(last=20), make, CameraSettings(tmp_path, video=0))
    page = TestClient(live_app([one]))
    assert page.get("/api/camera/gate").json()["boxes_left_out"]["surplus"] == 0
    one.start()
    until(lambda: source.through == 20)
    assert one.stop(60.0)
    left_out = page.get("/api/camera/gate").json()["boxes_left_out"]
    assert {reason: count for reason, count in left_out.items() if count} == {
        "empty": one.frames,
        "surplus": one.frames,
    }
    assert one.frames > 0
    assert (
        f'phdtrack_boxes_left_out_total{{camera="gate",reason="surplus"}} {one.frames}'
        in page.get("/metrics").text.splitlines()
    )


@pytest.mark.parametrize(
    "path",
    ["/picture/no.jpg", "/map/gate/faces.jpg", "/api/camera/no", "/api/camera/no/minutes", "/x"],
)
def test_what_is_not_there_is_404(page: TestClient, path: str) -> None:
    assert page.get(path).status_code == 404


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{", "expected JSON"),
        (b"[" * 30000, "expected JSON"),
        (b"[]", "expected an object"),
        (b'{"line": 3}', "[[line]]"),
        (b'{"circle": []}', "no table 'circle'"),
        (b'{"line": [{"points": [[0, 0], [NaN, 1]]}]}', "finite"),
        (b'{"line": [{"points": [[0, 0], [1' + b"0" * 400 + b", 1]]}]}", "pixels"),
        (b'{"line": [{"points": [[0, 0]]}]}', "at least 2 points"),
        (b'{"line": [{"name": "a\\ud800", "points": [[0, 0], [1, 1]]}]}', "character"),
        (b'{"zone": [{"name": "a\\u007f", "points": [[0, 0], [1, 1], [0, 1]]}]}', "character"),
        (
            json.dumps({"line": [{"points": [[0, k] for k in range(401)]}]}).encode(),
            "at most 50 lines and zones",
        ),
        (b" " * 70000, "at most 65536 bytes"),
    ],
)
def test_places_that_cannot_be_used_change_nothing(
    page: TestClient, camera: Camera, body: bytes, words: str
) -> None:
    before = camera.settings.places.read_bytes()
    answer = page.post("/api/camera/gate/places", content=body)
    assert answer.status_code == 400
    assert words in answer.json()["error"]
    assert camera.settings.places.read_bytes() == before


def test_a_camera_that_has_ended_is_not_healthy(page: TestClient, tmp_path: Path) -> None:
    assert page.get("/healthz").text == "ok\n"
    other = Camera(
        "yard", LiveSource("rtsp://127.0.0.1:9/"), lambda info: None, CameraSettings(tmp_path)
    )
    answer = TestClient(live_app([other])).get("/healthz")
    assert (answer.status_code, answer.text) == (503, "yard not working\n")
    assert other.stop(0.1)


def test_a_camera_without_a_picture_is_not_healthy(page: TestClient, camera: Camera) -> None:
    """It is healthy again with the next picture; before the limit it is still so."""
    source = camera.source
    working = source.status()
    assert page.get("/healthz").status_code == 200
    for state, since, status in (
        ("down", 31.0, 503),
        ("connecting", 31.0, 503),
        ("silent", 31.0, 503),
        ("down", 29.0, 200),
        ("live", 3600.0, 200),
    ):
        now = replace(working, state=state, since=since)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(LiveSource, "status", lambda source, now=now: now)
            answer = page.get("/healthz")
            assert answer.status_code == status
            assert ("without a picture for 31 s" in answer.text) == (status == 503)
            assert TestClient(live_app([camera], 60.0)).get("/healthz").status_code == 200
    assert page.get("/healthz").text == "ok\n"


@pytest.fixture(scope="module")
def address(
    server: CameraServer, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, Path]]:
    """A page that `phdtrack live` serves, and the folder of its camera."""
    out = tmp_path_factory.mktemp("live")
    sources = [f"gate={server.url}", "dead=rtsp://127.0.0.1:9/"]
    words = [sys.executable, "-m", "phdtrack", "live", *sources, "--out", str(out), "--video", "0"]
    with (out / "said").open("wb") as said:
        child = subprocess.Popen(
            [*words, "--set", "detector.min_area=0.005"], stdout=said, stderr=said
        )
        try:
            until(lambda: b"the page: " in (out / "said").read_bytes())
            yield (out / "said").read_text().split("the page: ")[1].split()[0], out / "gate"
        finally:
            child.terminate()
            assert child.wait(20) == 0


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize(
    ("width", "height", "scheme", "kind"),
    [(1280, 800, "light", "line"), (390, 844, "dark", "zone")],
)
def test_in_a_browser(
    browser, address, server: CameraServer, width: int, height: int, scheme: str, kind: str
) -> None:
    url, folder = address
    phone = width < 500
    errors = list[str]()
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, has_touch=phone
    )
    page = context.new_page()
    page.set_default_timeout(60_000)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on(
        "console", lambda message: errors.append(message.text) if message.type == "error" else None
    )
    page.goto(url)
    page.wait_for_selector("body[data-frame]")
    page.wait_for_selector("body[data-ready=gate]")
    # The white square is drawn on the canvas.
    drawn = "document.querySelector('#picture').getContext('2d').getImageData(0, 0, 160, 120).data"
    assert page.evaluate(f"Math.max(...{drawn}.filter((_, k) => k % 4 == 0))") > 200
    number = page.evaluate("Number(document.body.dataset.frame)")
    until(lambda: page.evaluate("Number(document.body.dataset.frame)") > number + 3)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.locator('#state dt:text("boxes left out") + dd').text_content() == "none"
    assert faults(page) == []
    assert (
        page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(18, 20, 23)"
    ) == (scheme == "dark")
    # Draw over the middle of the picture, where the square goes to and fro.
    corners = (
        [(80, 110), (80, 20)] if kind == "line" else [(60, 20), (100, 20), (100, 110), (60, 110)]
    )
    page.click(f"#{kind}")
    page.locator("#stage").scroll_into_view_if_needed()
    area = page.locator("#overlay").bounding_box()
    for x, y in corners:
        at = area["x"] + x * area["width"] / 160, area["y"] + y * area["height"] / 120
        page.touchscreen.tap(*at) if phone else page.mouse.click(*at)
    page.fill("#name", f"my <b>{kind}</b>")
    page.click("#save")
    page.wait_for_selector(f'#hint:text("my <b>{kind}</b> was saved")')
    place = next(
        one for one in read_places(folder / "places.toml") if one.name == f"my <b>{kind}</b>"
    )
    assert place.closed == (kind == "zone")
    assert all(
        abs(a - b) < 2
        for (x, y), (u, v) in zip(place.points, corners, strict=True)
        for a, b in ((x, u), (y, v))
    )
    # It is watched from then on.
    page.wait_for_selector(f'#list .what:text("my <b>{kind}</b>")')
    assert page.locator("#list b").count() == 0
    page.wait_for_selector("#chart path.most[d^=M]")
    # And no longer after two clicks.
    page.click(f'button[aria-label="delete my <b>{kind}</b>"]')
    page.click('button:text("delete?")')
    page.wait_for_selector("#none:visible")
    assert read_places(folder / "places.toml") == ()
    # The picture of a camera never stands under another's name, and nothing is drawn on a picture
    # that there is not.
    filled = (
        "document.querySelector('#picture').getContext('2d').getImageData(0, 0, 160,"
        " 120).data.some((one) => one > 0)"
    )
    for _ in range(5):
        page.click('#cameras button:has-text("dead")')
        page.wait_for_selector('#state dd:text-matches("^(down|connecting)")')
        assert not page.evaluate(filled)
        assert page.is_visible("#waiting")
        assert page.is_hidden("#line")
        page.click('#cameras button:has-text("gate")')
        page.wait_for_selector("#waiting", state="hidden")
        assert page.evaluate(filled)
    if not phone:
        server.kill()
        page.wait_for_selector('#state dd:text-matches("^(down|connecting)")')
        page.wait_for_selector('#stage.old #waiting:text-matches("no new pictures")')
        server.restart()
        page.wait_for_selector('#state dd:text-matches("^live")')
        page.wait_for_selector("#waiting", state="hidden")
    assert errors == []
    context.close()
    time.sleep(0.1)
