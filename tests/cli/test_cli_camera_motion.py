"""`phdtrack track --camera-motion`: a filmed street by a camera in a hand, measured, written, read
back, and refused.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from cli_runner import phdtrack, refused

from experiments.common import uniform_density
from moving_cases import filmed, handheld, moving, points, step
from phdtrack.formats import read_warps, write_detections, write_truth
from phdtrack.run.camera_motion import shaking_camera
from phdtrack.scene import LearnedDensity, Scene, write_scene
from phdtrack.simulate import DetectorModel, Rendered, make_scene
from phdtrack.types import STILL, Detections, Frame
from phdtrack.video import VideoWriter

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

FRAMES = 60


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """walk.mp4 as a moving camera sees a street, detections and truth in its pixels, and the true
    motion.
    """
    folder = tmp_path_factory.mktemp("walk")
    still = make_scene(
        "street", 3, DetectorModel(p_detect=0.9, clutter_rate=0.5), frames=FRAMES, lead_in=-6.0
    )
    path = handheld(FRAMES, np.random.default_rng(7))
    scene = moving(still, path)
    size = (still.info.width, still.info.height)
    write_detections(folder / "det.txt", scene.detections)
    write_truth(folder / "gt.txt", scene.truth)
    with VideoWriter(folder / "walk.mp4", *size, still.info.fps) as video:
        for frame in Rendered(still, np.random.default_rng(1)):
            video.write(filmed(frame, path, size).image)
    return folder, [step(path, k) for k in range(1, FRAMES + 1)]


def options(folder, out, *more):
    files = ("--detections", folder / "det.txt", "--truth", folder / "gt.txt", "--filter", "gm-phd")
    return ("track", folder / "walk.mp4", *files, "--no-video", "--out", out, "--json", *more)


def test_the_motion_is_measured_told_and_read_back(walk, tmp_path):
    folder, true = walk
    plain = phdtrack(*options(folder, tmp_path / "plain")).object
    flow = phdtrack(*options(folder, tmp_path / "flow", "--camera-motion", "flow")).object
    assert "camera_motion" not in plain
    assert not (tmp_path / "plain" / "camera_motion.csv").exists()
    assert flow["scores"]["IDF1"] > 1.3 * plain["scores"]["IDF1"]
    # What the file says is what the camera did, to a pixel at the corners after encoding.
    warps = read_warps(tmp_path / "flow" / "camera_motion.csv")
    corners = np.array([[0.0, 640, 640, 0], [0, 0, 360, 360]])
    np.testing.assert_array_equal(warps.frame, np.arange(2, FRAMES + 1))
    for k, warp in zip(warps.frame, warps.matrix, strict=True):
        wanted = points(true[k - 1], corners)
        np.testing.assert_allclose(points(warp, corners), wanted, atol=1.5)
    told = flow["camera_motion"]
    assert (told["kind"], told["frames"], told["frames_unmeasured"]) == ("flow", FRAMES - 1, 0)
    sentence = f"In 0 of {FRAMES - 1} frames the camera's motion could not be measured"
    assert sentence.replace("'", "&#39;") in (tmp_path / "flow" / "report.html").read_text(
        encoding="utf-8"
    )
    assert (
        json.loads((tmp_path / "flow" / "run.json").read_text(encoding="utf-8"))["camera_motion"]
        == told
    )
    # The file makes the same run, without looking at the pictures.
    again = options(
        folder, tmp_path / "again", "--camera-motion", tmp_path / "flow" / "camera_motion.csv"
    )
    assert phdtrack(*again).object["camera_motion"]["kind"] == "file"
    over = options(
        folder,
        tmp_path / "flow",
        "--camera-motion",
        tmp_path / "flow" / "camera_motion.csv",
        "--overwrite",
    )
    assert "camera_motion.csv is read for this run" in refused(
        *(word for word in over if word != "--json")
    )
    assert (tmp_path / "again" / "tracks.csv").read_bytes() == (
        tmp_path / "flow" / "tracks.csv"
    ).read_bytes()


def test_a_camera_that_shakes_is_steadied_by_itself(tmp_path):
    """Two cross before a wall. The tracker is told how the picture moves, also where detections are
    used again.
    """
    rng = np.random.default_rng(2)
    wall = cv2.resize(
        rng.integers(60, 200, (30, 40, 3), np.uint8), (320, 240), interpolation=cv2.INTER_CUBIC
    )
    truth = []
    with VideoWriter(tmp_path / "v.mp4", 320, 240, 10) as video:
        for k in range(60):
            image = wall.copy()
            shift = 5 * rng.standard_normal(2)
            for name, (left, top) in enumerate([(10 + 4 * k, 60), (280 - 4 * k, 150)], start=1):
                image[top : top + 60, left : left + 24] = 20
                truth.append(
                    f"{k + 1},{name},{left + shift[0]:.2f},{top + shift[1]:.2f},24,60,1,1,1\n"
                )
            matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
            video.write(cv2.warpAffine(image, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE))
    (tmp_path / "gt.txt").write_text("".join(truth), encoding="utf-8")
    run = (
        "track",
        tmp_path / "v.mp4",
        "--truth",
        tmp_path / "gt.txt",
        "--no-video",
        "--out",
        tmp_path / "run",
        "--json",
    )
    first = phdtrack(*run).object
    assert first["scores"]["MOTA"] > 0.8
    assert any("The camera shakes" in note for note in first["notes"])
    rows = (tmp_path / "run" / "tracks.csv").read_bytes()
    again = phdtrack(*run, "--overwrite").object
    assert again["detections_reused"]
    assert again["notes"] == first["notes"]
    assert (tmp_path / "run" / "tracks.csv").read_bytes() == rows


def test_warps_of_a_shaking_camera_span_unknown_poses():
    moved = shaking_camera()
    frame = Frame(1, 0.0, np.zeros((2, 2, 3), np.uint8))
    found = Detections.empty()
    poses = [np.array([[1.0, 0, x], [0, 1, -x], [0, 0, 1]]) for x in (1.0, 4.0)]
    assert len(moved(frame, found, poses[0])) == 0
    assert len(moved(frame, found, STILL)) == 0
    np.testing.assert_allclose(moved(frame, found, poses[1]), [[1, 0, 3], [0, 1, -3], [0, 0, 1]])


def test_what_does_not_go_together_is_refused(walk, tmp_path):
    folder, _ = walk
    alone = (
        "track",
        "--detections",
        folder / "det.txt",
        "--frame-size",
        "640x360",
        "--fps",
        25,
        "--out",
        tmp_path / "out",
    )
    assert "measured in pictures, and there are detections only" in refused(
        *alone, "--camera-motion", "flow"
    )
    assert "there is no such file" in refused(*alone, "--camera-motion", tmp_path / "none.csv")
    (tmp_path / "still.csv").write_text("2,1,0,0,0,1,0\n", encoding="utf-8")
    given = (*alone, "--camera-motion", tmp_path / "still.csv")
    anywhere = uniform_density(np.zeros(4), np.array([640.0, 360, 640, 360]))
    write_scene(
        tmp_path / "scene.json", Scene(640, 360, 25.0, "", clutter=LearnedDensity(1.0, anywhere))
    )
    assert "stands still" in refused(*given, "--scene", tmp_path / "scene.json")
    assert "camera_motion.kind=file does not fit motion.kind=plane" in refused(
        *given, "--preset", "e13"
    )
    assert not (tmp_path / "out").exists()


def test_a_motion_that_goes_on_after_the_last_detection_is_read(walk, tmp_path):
    """Detections end with the last object that was seen; the camera moves on."""
    folder, true = walk
    alone = (
        "track",
        "--detections",
        folder / "det.txt",
        "--frame-size",
        "640x360",
        "--fps",
        25,
        "--no-video",
    )
    lines = [
        "{},{},{},{},{},{},{}".format(k, *warp[:2].ravel())
        for k, warp in enumerate(true[1:], start=2)
    ]
    for name, more in (("short", []), ("long", ["900,1,0,50,0,1,0"])):
        (tmp_path / f"{name}.csv").write_text("\n".join([*lines, *more]) + "\n", encoding="utf-8")
        phdtrack(*alone, "--camera-motion", tmp_path / f"{name}.csv", "--out", tmp_path / name)
    assert (tmp_path / "long" / "tracks.csv").read_bytes() == (
        tmp_path / "short" / "tracks.csv"
    ).read_bytes()
