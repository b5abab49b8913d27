"""`phdtrack track --set rates.kind=learned`: what is told on the terminal, in run.json and in the report."""

import json

import pytest
from cli_runner import phdtrack

from phdtrack.formats import write_detections
from phdtrack.simulate import DetectorModel, make_scene


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rates")
    detector = DetectorModel(p_detect=0.7, clutter_rate=6.0, scores="informative")
    write_detections(folder / "det.txt", make_scene("street", 1, detector, frames=200).detections)
    return folder / "det.txt"


def options(file, out, *more):
    return ("track", "--detections", file, "--frame-size", "640x360", "--fps", 25, "--no-video", "--out", out, *more)


def test_the_rates_are_told_and_their_course_is_kept(street, tmp_path):
    sets = ("--filter", "gm-phd", "--set", "rates.kind=learned", "--set", "rates.detection=true")
    run = phdtrack(*options(street, tmp_path / "run", "--json", *sets)).object
    told, course = run["rates"], run["rates"]["course"]
    assert (told["set"]["detection"], told["used"]["detection"], told["used"]["clutter"]) == (0.8, True, False)
    assert len(course) > 5
    assert [one["time"] for one in course] == sorted(one["time"] for one in course)
    assert course[-1]["detection"] < 0.8
    assert course[-1]["lowest"] < 1 < course[-1]["highest"]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    for words in ("Rates learned from the stream", "probability of detection", "odds of the best score"):
        assert words in page
    assert run == json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))


def test_rates_and_a_scene_are_reported_together(street, tmp_path):
    sets = ("--filter", "gm-phd", "--set", "rates.kind=learned", "--learn-online")
    said = phdtrack(*options(street, tmp_path / "both", "--json", *sets))
    assert said.object["rates"]["course"]
    assert said.object["learning"]["course"]
    assert "estimated from the stream" in " ".join(said.err.split())
