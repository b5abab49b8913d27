"""`phdtrack track --learn-online`: what it writes, what another run begins with, and what is refused."""

import json

import pytest
from cli_runner import phdtrack

from phdtrack.formats import write_detections, write_truth
from phdtrack.scene import read_scene
from phdtrack.simulate import DetectorModel, make_scene


@pytest.fixture(scope="module")
def yard(tmp_path_factory):
    """Detections with five places that fire, and the truth."""
    folder = tmp_path_factory.mktemp("yard")
    scene = make_scene("street", 1, DetectorModel(occlusion=2.0, clutter_rate=1.0, places=5), frames=600)
    write_detections(folder / "det.txt", scene.detections)
    write_truth(folder / "gt.txt", scene.truth)
    return folder


def options(folder, out, *more):
    files = ("--detections", folder / "det.txt", "--truth", folder / "gt.txt", "--frame-size", "640x360", "--fps", 25)
    return ("track", *files, "--no-video", "--out", out, "--json", *more)


def test_learns_and_another_run_begins_with_it(yard, tmp_path):
    plain = phdtrack(*options(yard, tmp_path / "plain")).object
    first = phdtrack(*options(yard, tmp_path / "first", "--learn-online", "--set", "learn.memory=1.0")).object
    course = first["learning"]["course"]
    assert first["learning"]["memory_minutes"] == 1
    assert course[-1]["false_alarms_used"]
    assert course[-1]["false_alarms_per_frame"] == pytest.approx(3.5, rel=0.2)
    assert any("false alarms in use" in said for entry in course for said in entry["said"])
    assert first["configuration"]["learn"]["kind"] == "online"
    assert "What was learned of the scene" in (tmp_path / "first" / "report.html").read_text(encoding="utf-8")
    scene = read_scene(tmp_path / "first" / "scene.json")
    assert (scene.width, scene.height, scene.notes["mode"]) == (640, 360, "first")
    assert len(scene.clutter.density) > 3
    # The second run knows the places from its first frame on; given as a file they stay what they are.
    more = ("--learn-online", "--scene", tmp_path / "first")
    then = phdtrack(*options(yard, tmp_path / "then", *more)).object
    fixed = phdtrack(*options(yard, tmp_path / "fixed", "--scene", tmp_path / "first" / "scene.json")).object
    false = [one["scores"]["false_positives"] for one in (plain, first, then, fixed)]
    assert false[1] < 0.7 * false[0]
    assert false[2] < 0.2 * false[0]
    assert false[3] < 0.2 * false[0]


def test_what_is_learned_is_written_beside_scores_that_count(yard, tmp_path):
    run = phdtrack(
        *options(yard, tmp_path / "run", "--preset", "default", "--learn-online", "--set", "learn.memory=1.0")
    ).object
    assert run["learning"]["course"]
    assert len(read_scene(tmp_path / "run" / "scene.json").clutter.density) > 3


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--learn-online", "--filter", "none"), "learn.kind=online does not fit filter.kind=none"),
        (("--set", "learn.memory=2"), "unknown setting of [learn]: memory"),
        (("--learn-online", "--set", "learn.memory=0.0"), "memory"),
        (("--learn-online", "--scene", "."), "no scene*.json"),
    ],
)
def test_what_does_not_go_is_told(yard, tmp_path, monkeypatch, more, words):
    monkeypatch.chdir(tmp_path)
    said = phdtrack(*options(yard, tmp_path / "out", *more))
    assert said.status == 2
    assert words in said.err
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rates")
    detector = DetectorModel(p_detect=0.7, clutter_rate=6.0, informative_scores=True)
    write_detections(folder / "det.txt", make_scene("street", 1, detector, frames=200).detections)
    return folder / "det.txt"


def test_the_rates_are_told_and_their_course_is_kept(street, tmp_path):
    given = ("--detections", street, "--frame-size", "640x360", "--fps", 25, "--out", tmp_path / "run", "--json")
    sets = ("--filter", "gm-phd", "--set", "rates.kind=learned", "--set", "rates.detection=true", "--learn-online")
    said = phdtrack("track", *given, *sets)
    run = said.object
    told, course = run["rates"], run["rates"]["course"]
    assert (told["set"]["detection"], told["used"]["detection"], told["used"]["clutter"]) == (0.8, True, False)
    assert len(course) > 5
    assert [one["time"] for one in course] == sorted(one["time"] for one in course)
    assert course[-1]["detection"] < 0.8
    assert course[-1]["lowest"] < 1 < course[-1]["highest"]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    for words in ("Rates learned from the stream", "probability of detection", "odds of the best score"):
        assert words in page
    # A scene is learned at the same time.
    assert run["learning"]["course"]
    assert "estimated from the stream" in " ".join(said.err.split())
    assert run == json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))
