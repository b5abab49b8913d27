"""``phdtrack learn``: from detections and marks to scene.json and its page."""

import shutil

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from phdtrack.cli.output import Output
from phdtrack.label import DRAWN, Label, LabelStore
from phdtrack.label.sequences import open_sequence
from phdtrack.run.requests import SourceRequest
from phdtrack.scene import read_scene

FRAMES = 900


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """Detections of people who leave one door to the right, and of a flag in the corner.

    On the first 200 frames every flag is marked, and whoever is new.
    """
    folder = tmp_path_factory.mktemp("street")
    rng = np.random.default_rng(0)
    rows = []
    for begin in range(5, FRAMES - 40, 12):
        start = np.array([60.0, 200]) + rng.normal(0, 4, 2)
        for k in range(35):
            x, y = start + np.array([4.0 * k, 0]) + rng.normal(0, 0.5, 2)
            rows.append((begin + k, x, y, 30 + rng.normal(0, 0.5), 80 + rng.normal(0, 0.5)))
    for k in range(1, FRAMES + 1):
        if rng.random() < 0.4:
            x, y = np.array([600.0, 40]) + rng.normal(0, 3, 2)
            rows.append((k, x, y, 24, 24))
    lines = [
        f"{k},-1,{x:.2f},{y:.2f},{w:.2f},{h:.2f},1,-1,-1,-1"
        for k, x, y, w, h in sorted(rows, key=lambda row: row[0])
    ]
    (folder / "det.txt").write_text("\n".join(lines) + "\n")
    found = open_sequence(
        SourceRequest("", folder / "det.txt", "", "720x480", 25.0), {}, folder / "labels", Output()
    )
    store = LabelStore.open(folder / "labels", str(folder / "det.txt"), found.digest, range(1, 201))
    for number in range(1, 201):
        flags = [k for k, box in enumerate(found.table.at(number).xyxy) if box[0] > 500]
        if flags:
            store.mark(number, [Label(number, k, "false") for k in flags])
        # Whoever begins is the leftmost of those at the door.
        if (number - 5) % 12 == 0:
            people = [
                (box[0], k) for k, box in enumerate(found.table.at(number).xyxy) if box[0] < 500
            ]
            store.mark(number, [Label(number, min(people)[1], "birth")])
        store.finish(number)
    return folder


def options(street):
    given = (
        "--detections",
        street / "det.txt",
        "--frame-size",
        "720x480",
        "--fps",
        "25",
        "--labels",
        street / "labels",
    )
    return ("learn", *given)


@pytest.fixture(scope="module")
def learned(street):
    """The words of the command with all marks, and the folder with its files."""
    said = phdtrack(*options(street), "--out", street / "learned" / "scene.json", "--json")
    assert said.status == 0, said.err
    return said, street / "learned"


def test_a_door_and_a_flag_are_learned(learned):
    said, folder = learned
    scene = read_scene(folder / "scene.json")
    births = scene.births
    clutter = scene.clutter
    # One every twelve frames.
    assert births.rate == pytest.approx(1 / 12, rel=0.1)
    door = births.density.mean[:, np.argmax(births.density.weight)]
    # The detections' corner is (60, 200); people walk 4 pixels a frame.
    assert door == pytest.approx([75, 240, 4, 0, 30, 80], abs=6)
    assert clutter.rate == pytest.approx(0.4, abs=0.15)
    flag = clutter.density.mean[:, np.argmax(clutter.density.weight)]
    assert flag == pytest.approx([612, 52, 24, 24], abs=3)
    assert said.object["gain"]["births"] > 8
    assert said.object["gain"]["clutter"] > 5
    assert "tracks began in" in said.err
    page = (folder / "scene.html").read_text()
    assert page.count("data:image/jpeg") == 2
    assert "Not learned" not in page


def test_missed_objects_teach_where_objects_are(street, learned, tmp_path):
    """On 40 frames somebody is drawn who stands where the detector never sees anybody."""
    shutil.copy(street / "labels", tmp_path / "labels")
    for number in range(1, 41):
        LabelStore(tmp_path / "labels").mark(
            number, [Label(number, DRAWN, "true", (300.0, 50.0, 330.0, 130.0))]
        )
    said = phdtrack(*options(street)[:-1], tmp_path / "labels", "--out", tmp_path / "scene.json")
    assert said.status == 0, said.err
    scenes = [read_scene(folder / "scene.json") for folder in (learned[1], tmp_path)]
    # 17 people on 538 of these frames' detections, and the 40.
    assert "200 frames, where the detector missed 40 of 578 objects (it detects 93 %)" in said.out
    without, drawn = (scene.followed.objects for scene in scenes)
    there = np.array([[315.0], [90], [30], [80]])
    assert drawn.rate == pytest.approx(without.rate + 40 / 200)
    assert drawn.rate * drawn.density(there)[0] > 100 * without.rate * without.density(there)[0]
    # They are no false alarms.
    assert scenes[1].clutter.rate == scenes[0].clutter.rate


def test_births_by_hand(street, tmp_path):
    target = tmp_path / "scene.json"
    said = phdtrack(*options(street), "--births", "hand", "--out", target)
    assert said.status == 0, said.err
    # 5, 17, …, 197, seen on the clips about the frames 1 … 200, which begin to count with the
    # second.
    assert "births: 17 births marked by a person on 209 frames" in said.out
    scene = read_scene(target)
    assert scene.births.rate == pytest.approx(17 / 209)
    assert scene.births.samples == 17
    door = scene.births.density.mean[:, np.argmax(scene.births.density.weight)]
    assert door == pytest.approx([75, 240, 4, 0, 30, 80], abs=6)
    assert (scene.notes["births from"], scene.notes["clutter from"]) == ("hand", "labels")
    assert "marked by a person on 209 frames" in (tmp_path / "scene.html").read_text()
    # Of a part of the frames only what lies there.
    said = phdtrack(
        *options(street), "--births", "hand", "--first", "30", "--out", tmp_path / "later.json"
    )
    assert "births: 14 births marked by a person on 180 frames" in said.out


def test_false_alarms_unattended(street, tmp_path):
    target = tmp_path / "scene.json"
    said = phdtrack(
        *options(street)[:-2],
        "--clutter",
        "unattended",
        "--first",
        "100",
        "--last",
        "899",
        "--out",
        target,
    )
    assert said.status == 0, said.err
    assert "No person has checked them" in said.out
    assert "at 1 place that fire too often" in said.out
    scene = read_scene(target)
    assert scene.clutter.rate == pytest.approx(0.4, abs=0.1)
    flag = scene.clutter.density.mean[:, np.argmax(scene.clutter.density.weight)]
    assert flag == pytest.approx([612, 52, 24, 24], abs=3)
    assert (scene.notes["first"], scene.notes["last"], scene.notes["clutter from"]) == (
        100,
        899,
        "unattended",
    )
    assert "No person has checked them" in (tmp_path / "scene.html").read_text()
    # Half a second of a flag is no evidence.
    said = phdtrack(
        *options(street)[:-2],
        "--clutter",
        "unattended",
        "--last",
        "12",
        "--out",
        tmp_path / "short.json",
    )
    assert (said.status, "nothing was learned" in said.err) == (0, True)
    assert "false alarms not learned, defaults kept: expected at least 10 detections" in said.out
    assert "Look yourself" in said.out


def test_mistakes_are_told(street, tmp_path):
    assert "no such file of labels" in refused(*options(street)[:-1], tmp_path / "none")
    (tmp_path / "scene.json").write_text("mine")
    assert "exists already" in refused(*options(street), "--out", tmp_path / "scene.json")
    assert (tmp_path / "scene.json").read_text() == "mine"
    assert "expected tracks or hand, got 'feet'" in refused(*options(street), "--births", "feet")
    assert "for boxes in the image only" in refused(
        *options(street), "--set", "motion.kind=point", "--out", tmp_path / "p"
    )
    assert "expected labels or unattended" in refused(*options(street), "--clutter", "none")
    assert "no frames from 950 to 899" in refused(
        *options(street), "--first", "950", "--out", tmp_path / "s.json"
    )
    short = (*options(street)[:-2], "--out", tmp_path / "s.json", "--last", "8")
    done = phdtrack(*short)
    assert done.status == 2
    assert "nothing could be learned" in done.err
    assert not (tmp_path / "s.json").exists()


def test_labels_of_other_detections_are_refused(street, tmp_path):
    changed = (street / "det.txt").read_text().splitlines()[:-3]
    (tmp_path / "det.txt").write_text("\n".join(changed) + "\n")
    said = refused(
        *options(street), "--detections", tmp_path / "det.txt", "--out", tmp_path / "s.json"
    )
    assert "other detections" in said


def test_marks_that_lie_anywhere_teach_nothing_of_where(tmp_path):
    rng = np.random.default_rng(0)
    lines = []
    for k in range(1, 31):
        x, y = rng.uniform(0, (720, 480))
        w, h = rng.uniform(4, 300, 2)
        lines.append(f"{k},-1,{x - w / 2:.1f},{y - h / 2:.1f},{w:.1f},{h:.1f},1,-1,-1,-1")
    (tmp_path / "det.txt").write_text("\n".join(lines) + "\n")
    given = SourceRequest("", tmp_path / "det.txt", "", "720x480", 25.0)
    found = open_sequence(given, {}, tmp_path / "labels", Output())
    store = LabelStore.open(tmp_path / "labels", "det.txt", found.digest, range(1, 31))
    for number in range(1, 31):
        store.mark(number, [Label(number, 0, "false")])
        store.finish(number)
    said = phdtrack(*options(tmp_path), "--out", tmp_path / "scene.json")
    assert said.status == 0, said.err
    assert (
        "false alarms: 30 boxes marked by a person on 30 frames; nothing was learned of where, as"
        " no place" in said.out
    )
    page = (tmp_path / "scene.html").read_text()
    assert "False alarms: no places learned from 30 samples." in page
    assert "Map of false alarms" not in page
