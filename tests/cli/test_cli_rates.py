"""`phdtrack track --set rates.kind=learned`: what a run says of its rates."""

import json

import pytest
from cli_runner import phdtrack

from phdtrack.formats import write_detections
from phdtrack.simulate import DetectorModel, make_scene


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rates")
    detector = DetectorModel(p_detect=0.7, clutter_rate=6.0)
    write_detections(folder / "det.txt", make_scene("street", 1, detector, frames=200).detections)
    return folder / "det.txt"


def test_the_rates_are_told_and_their_course_is_kept(street, tmp_path):
    given = ("--detections", street, "--frame-size", "640x360", "--fps", 25, "--out", tmp_path / "run", "--json")
    sets = ("--filter", "gm-phd", "--set", "rates.kind=learned", "--set", "rates.detection=true")
    said = phdtrack("track", *given, *sets)
    run = said.object
    told, course = run["rates"], run["rates"]["course"]
    assert (told["set"]["detection"], told["used"]["detection"], told["used"]["clutter"]) == (0.8, True, False)
    assert len(course) > 5
    assert [one["time"] for one in course] == sorted(one["time"] for one in course)
    assert course[-1]["detection"] < 0.8
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    for words in ("Rates learned from the stream", "probability of detection", "false alarms around"):
        assert words in page
    assert "estimated from the stream" in " ".join(said.err.split())
    assert run == json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))
