"""What learning a scene buys, through the commands: simulate, mark on 40 frames as the truth says, learn, track."""

from pathlib import Path

import pytest
from cli_runner import phdtrack

from phdtrack.boxes import iou
from phdtrack.commands.label_inputs import to_label
from phdtrack.commands.output import Output
from phdtrack.commands.wanted import Wanted
from phdtrack.formats import read_truth
from phdtrack.label import Label, LabelStore
from phdtrack.label.session import sampled


def marked(folder: Path) -> Path:
    """Labels of what is on no annotated person, on 40 frames drawn at random."""
    detections, labels = folder / "det" / "det.txt", folder / "labels.sqlite"
    found, truth = to_label(Wanted(detections=detections), {}, labels, Output()), read_truth(folder / "gt" / "gt.txt")
    store = LabelStore.open(labels, str(detections), found.digest, sampled(found.last, 40, seed=0))
    for number, _ in store.frames():
        boxes, people = found.table.at(number).xyxy, truth.xyxy[truth.frame == number]
        false = [k for k, box in enumerate(boxes) if iou(box[None], people).max(initial=0) < 0.3]
        if false:
            store.mark(number, [Label(number, k, "false") for k in false])
        store.finish(number)
    return labels


@pytest.mark.parametrize("name", ["particle-phd", "gm-phd"])
def test_places_that_fire_are_unlearned_in_forty_frames(tmp_path: Path, name: str):
    """Five places where something is reported in every other frame. The scene's people are not lost by it."""
    yard = tmp_path / "yard"
    assert phdtrack("simulate", "street", "--out", yard, "--frames", 600, "--seed", 1, "--no-video").status == 0
    detections, scene = yard / "det" / "det.txt", tmp_path / "scene.json"
    learned = phdtrack("learn", "--detections", detections, "--labels", marked(yard), "--out", scene)
    assert learned.status == 0, learned.err
    common = (
        "track",
        "--detections",
        detections,
        "--truth",
        yard / "gt" / "gt.txt",
        "--filter",
        name,
        "--no-video",
        "--json",
    )
    plain = phdtrack(*common, "--out", tmp_path / "plain").object["scores"]
    taught = phdtrack(*common, "--out", tmp_path / "taught", "--scene", scene).object["scores"]
    assert taught["false_positives"] <= 0.15 * plain["false_positives"]
    assert taught["false_tracks"] < plain["false_tracks"]
    assert taught["MOTA"] > max(0.9, plain["MOTA"] + 0.3)


def test_what_nobody_marked_is_unlearned_too(tmp_path: Path):
    """The same places, taken from what would be suggested: learned on the first half of the scene, tracked on all of it."""
    yard = tmp_path / "yard"
    assert phdtrack("simulate", "street", "--out", yard, "--frames", 600, "--seed", 1, "--no-video").status == 0
    detections, scene = yard / "det" / "det.txt", tmp_path / "scene.json"
    learned = phdtrack("learn", "--detections", detections, "--clutter", "unattended", "--last", 300, "--out", scene)
    assert learned.status == 0, learned.err
    common = ("track", "--detections", detections, "--truth", yard / "gt" / "gt.txt", "--no-video", "--json")
    plain = phdtrack(*common, "--out", tmp_path / "plain").object["scores"]
    taught = phdtrack(*common, "--out", tmp_path / "taught", "--scene", scene).object["scores"]
    print(f"MOTA {plain['MOTA']:.3f} uniform, {taught['MOTA']:.3f} unattended")
    assert taught["MOTA"] > max(0.9, plain["MOTA"] + 0.3)
    assert taught["false_positives"] <= 0.15 * plain["false_positives"]
