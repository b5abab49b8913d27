"""Marks as COCO and CVAT: what is written is read again, and what other tools drew is matched with
the detections.
"""

import json
import re

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.formats.annotations import read_annotated
from phdtrack.label import DRAWN, Label, LabelStore
from phdtrack.label.exchange import Exchange, Imported, frames_of
from phdtrack.types import Detections, DetectionTable, SequenceInfo

INFO = SequenceInfo(640, 480, 25.0, 100, "street")
BOXES = np.array([[10.25, 20, 50, 100], [200, 100, 240, 180], [400, 300, 450.5, 400]])
MOVED = (205.5, 100.0, 250.0, 190.25)
DREW = (300.0, 200.0, 330.0, 260.0)


def exchange(path, digest="abc", frames=(30, 10, 60), shift=0.0):
    """Labels of three detections in each of 100 frames."""
    table = DetectionTable(
        np.repeat(np.arange(1, 101), 3), Detections.of(np.tile(BOXES + shift, (100, 1)))
    )
    return Exchange(LabelStore.open(path, "street", digest, frames), table, INFO)


@pytest.fixture
def marked(tmp_path):
    """Every kind of mark, by several people; one frame is done without any."""
    made = exchange(tmp_path / "labels.sqlite")
    store = made.store
    store.mark(30, [Label(30, 0, "false"), Label(30, 1, "true", MOVED)], who="ann")
    store.mark(30, [Label(30, DRAWN + 5, "true", DREW), Label(30, 2, "false")], who='bob "b" <ü>')
    store.mark(30, [Label(30, 2, "none")], who="ann")
    store.mark(
        10,
        [Label(12, 2, "birth"), Label(12, DRAWN + 9, "birth", DREW), Label(10, 1, "birth", MOVED)],
        who="ann",
    )
    store.mark(60, [Label(60, 0, "false")])
    for number in (30, 10):
        store.finish(number, who="ann")
    return made


def written(made, folder, kind):
    path = folder / f"marks.{kind}"
    path.write_text(made.text(kind), encoding="utf-8")
    return path


def who(store):
    return {(label.frame, label.box): label.who for label in store.labels()}


@pytest.mark.parametrize("kind", ["json", "xml"])
def test_nothing_is_lost_on_the_way(marked, tmp_path, kind):
    path = written(marked, tmp_path, kind)
    given = read_annotated(path)
    again = exchange(tmp_path / "again.sqlite", frames=frames_of(given))
    for _ in range(2):
        taken = again.import_file(given)
        assert taken == Imported(false=2, objects=3, drawn=2, done=2, elsewhere=0, unmatched=0)
        assert again.store.labels() == marked.store.labels()
        assert who(again.store) == who(marked.store)
        assert (
            again.store.frames() == marked.store.frames() == [(30, True), (10, True), (60, False)]
        )
    # Marks of the clip are undone on the drawn frame.
    assert again.store.steps(10, "ann")[0] > 0
    assert again.text(kind) == path.read_text(encoding="utf-8")
    # It is a file of boxes as any other: 3 + 1 on frame 30, 3 on 10, 2 on 12, 1 on 60.
    assert read_detections(path).frame.tolist() == [10] * 3 + [12] * 2 + [30] * 4 + [60]
    objects = [box for box in given.boxes if box["label"] == "object"]
    assert len(objects) == len(given.boxes) - 2


@pytest.mark.parametrize("kind", ["json", "xml"])
def test_labels_of_other_detections_are_matched(marked, tmp_path, kind):
    """The detector is another one, three pixels off: a mark goes to the box that overlaps most;
    places stay.
    """
    again = exchange(tmp_path / "again.sqlite", "xyz", shift=3.0)
    taken = again.import_file(read_annotated(written(marked, tmp_path, kind)))
    assert taken == Imported(false=2, objects=3, drawn=2, done=2, elsewhere=0, unmatched=0)
    found = {(label.frame, label.box): label for label in again.store.labels()}
    assert found[30, 0] == Label(30, 0, "false")
    assert found[30, 1] == Label(30, 1, "true", MOVED)
    assert found[12, 2].place == tuple(BOXES[2])
    assert sorted(label.place for label in found.values() if label.box >= DRAWN) == [DREW, DREW]


def test_a_frame_is_done_if_the_file_has_all_its_detections(marked, tmp_path):
    """Here are detections in another place: nobody has said that they are true."""
    again = exchange(tmp_path / "again.sqlite", "xyz", shift=70.0)
    taken = again.import_file(read_annotated(written(marked, tmp_path, "json")))
    assert (taken.false, taken.done, taken.unmatched) == (0, 0, 2)
    assert [done for _, done in again.store.frames()] == [False] * 3
    assert all(label.box >= DRAWN for label in again.store.labels())


def test_what_was_edited_in_cvat_comes_back(marked, tmp_path):
    """CVAT leaves out what it does not know of the file itself. A true box was moved there, one
    drawn, one removed.
    """
    text = re.sub(r"<meta>.*</meta>", "<meta/>", marked.text("xml"))
    new = '<box label="object" xtl="500" ytl="10" xbr="540" ybr="90"/>'
    text = re.sub(r'(<image id="9".*?>)', rf"\1{new}", text).replace('xtl="400"', 'xtl="404"', 1)
    (tmp_path / "marks.xml").write_text(text, encoding="utf-8")
    again = exchange(tmp_path / "again.sqlite")
    taken = again.import_file(read_annotated(tmp_path / "marks.xml"), "cvat")
    assert (taken.false, taken.drawn, taken.done) == (2, 3, 2)
    (drawn,) = [label for label in again.store.labels(10) if label.box >= DRAWN]
    assert (drawn.place, drawn.who) == ((500, 10, 540, 90), "cvat")
    assert Label(10, 2, "true", (404.0, 300.0, 450.5, 400.0)) in again.store.labels(10)


COCO = {
    "images": [
        {"id": 7, "file_name": "frame_000009.png"},
        {"id": 8, "file_name": "frame_000000.png", "width": 640, "height": 480},
    ],
    "annotations": [
        {"id": 1, "image_id": 7, "category_id": 3, "bbox": [200, 100, 44, 84]},
        {"id": 2, "image_id": 7, "category_id": 3, "bbox": [300, 200, 30, 60]},
        {"id": 3, "image_id": 8, "category_id": 3, "bbox": [300, 200, 30, 60]},
    ],
    "categories": [{"id": 3, "name": "person"}],
}
CVAT = """<annotations><track id="0" label="person">
<box frame="9" outside="0" xtl="200" ytl="100" xbr="244" ybr="184"/>
<box frame="10" outside="1" xtl="0" ytl="0" xbr="9" ybr="9"/>
</track><track id="1" label="person"><box frame="9" xtl="300" ytl="200" xbr="330" ybr="260"/>
<box frame="80" xtl="300" ytl="200" xbr="330" ybr="260"/></track></annotations>"""


@pytest.mark.parametrize("text", [json.dumps(COCO), CVAT], ids=["coco", "cvat"])
def test_boxes_of_other_tools_are_places_and_missed_objects(tmp_path, text):
    """Both files count from 0: frame 9 is the tenth. The other frame is not one of those to
    label.
    """
    path = tmp_path / "theirs"
    made = exchange(tmp_path / "labels.sqlite")
    path.write_text(text)
    for _ in range(2):
        taken = made.import_file(read_annotated(path), "eve")
        assert taken == Imported(false=0, objects=1, drawn=1, done=0, elsewhere=1, unmatched=0)
        seen, drawn = made.store.labels()
        assert seen == Label(10, 1, "true", (200.0, 100.0, 244.0, 184.0))
        assert (drawn.frame, drawn.mark, drawn.place) == (10, "true", DREW)
        assert {seen.who, drawn.who} == {"eve"}


def test_an_unusable_file_is_refused_and_changes_nothing(tmp_path):
    made = exchange(tmp_path / "labels.sqlite")
    path = tmp_path / "theirs"
    other = [{**image, "width": 1920, "height": 1080} for image in COCO["images"]]
    path.write_text(json.dumps(COCO | {"images": other}))
    with pytest.raises(InputError, match=r"expected pictures of 640 x 480, got 1920 x 1080"):
        made.import_file(read_annotated(path))
    assert made.store.labels() == []
    for text, words in (
        ("<dataset/>", "expected CVAT, whose outermost element"),
        (
            json.dumps(COCO | {"images": [{"id": 1, "frame_id": 1.5}], "annotations": []}),
            "whole frame numbers",
        ),
        ("7", "expected COCO .JSON. or CVAT .XML., got b'7'"),
        (
            (
                '<annotations><image id="1"><box xtl="1" ytl="1" xbr="x"'
                ' ybr="2"/></image></annotations>'
            ),
            "finite number for xbr",
        ),
        (json.dumps([{"image_id": 1, "bbox": [1, 2, 0, 4]}]), "a box with a width and a height"),
        ('[{"image_id": 1, "bbox": [1, NaN, 3, 4]}]', "a box with a width and a height"),
        ('<annotations><box xtl="1" ytl="1" xbr="3" ybr="2"/></annotations>', "frame"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            read_annotated(path)
