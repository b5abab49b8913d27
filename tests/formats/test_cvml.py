"""CVML: boxes, groups, and malformed XML."""

from pathlib import Path

import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks, read_truth

GOOD = """<?xml version="1.0" encoding="UTF-8"?>
<dataset name="x">
  <frame number="0">
    <objectlist>
      <object id="0"><orientation>90</orientation><box h="10" w="4" xc="100" yc="50.5"/></object>
      <object id="7"><box h="10" w="4" xc="20" yc="30"/></object>
    </objectlist>
    <grouplist>
      <group id="2"><box h="40" w="90" xc="60" yc="40"/><members>0, 7</members></group>
    </grouplist>
  </frame>
  <frame number="1"><objectlist/><grouplist/></frame>
  <frame number="2"><objectlist>\
<object id="7"><box h="10" w="4" xc="21" yc="30"/></object></objectlist></frame>
</dataset>
"""


def test_boxes_of_groups_are_skipped(tmp_path: Path) -> None:
    path = put(tmp_path, GOOD, "scene.xml")
    truth = read_truth(path)
    assert truth.frame.tolist() == [1, 1, 3]
    assert truth.identity.tolist() == [0, 7, 7]
    assert truth.xyxy[0].tolist() == [98, 45.5, 102, 55.5]
    assert not truth.distractor.any()
    assert read_tracks(path).identity.tolist() == [0, 7, 7]
    assert read_detections(path).detections.xyxy.tolist() == truth.xyxy.tolist()


def test_first_frame_can_be_given(tmp_path: Path) -> None:
    path = put(
        tmp_path,
        GOOD.replace('number="0"', 'number="1"').replace('number="1"><objectlist/>', 'number="3">'),
    )
    assert read_truth(path, first_frame=1).frame.tolist() == [1, 1, 2]
    assert len(read_truth(put(tmp_path, "<dataset/>"))) == 0


@pytest.mark.parametrize(
    ("change", "line", "words"),
    [
        (('xc="20"', 'xc="twenty"'), 6, "a finite number for xc of <box>, got 'twenty'"),
        (('xc="20" ', ""), 6, "<box> with a value for xc"),
        (('w="4" xc="20"', 'w="0" xc="20"'), 6, "width and a height above 0, got width 0"),
        (
            ('id="7"><box h="10" w="4" xc="20"', 'id="0"><box h="10" w="4" xc="20"'),
            6,
            "identity 0 is in frame 1",
        ),
        (('number="2"', 'number="-1"'), 13, "expected frame 0 or later, got -1"),
        (('<object id="0">', "<object>"), 5, "<object> with a value for id"),
        (
            ("</objectlist>\n    <grouplist>", "\n    <grouplist>"),
            11,
            "XML, which breaks here: mismatched tag",
        ),
        (("</dataset>\n", ""), 14, "XML, which breaks here"),
        (
            (
                '<frame number="1"><objectlist/>',
                '<box h="1" w="1" xc="1" yc="1"/><frame number="1">',
            ),
            12,
            "got one outside",
        ),
        (
            ("dataset", "Camera"),
            2,
            "outermost element is <dataset> or <annotations>, got <Camera>",
        ),
    ],
)
def test_the_message_names_the_line(
    tmp_path: Path, change: tuple[str, str], line: int, words: str
) -> None:
    assert change[0] in GOOD
    refused(read_truth, put(tmp_path, GOOD.replace(*change)), f", line {line}", words)


@pytest.mark.parametrize(
    "declaration",
    [
        '<!DOCTYPE dataset [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE dataset [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE dataset SYSTEM "cvml.dtd">',
    ],
)
def test_document_types_and_entities_are_refused(tmp_path: Path, declaration: str) -> None:
    path = put(tmp_path, f"{declaration}\n<dataset/>")
    for reader in (read_truth, read_detections):
        with pytest.raises(
            InputError, match=r"line 1: .*without a document type and entities.*DOCTYPE"
        ):
            reader(path)
