"""What networks without metadata mean, by the shapes and values of their outputs.

Each network has the same outputs for every picture, in the layout of an exporter.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import networks
from phdtrack.detect.base import guesses
from phdtrack.detect.detectors import make_detector
from phdtrack.detect.onnx import OnnxDetector
from phdtrack.detect.onnx_layouts import LAYOUTS, of_picture
from phdtrack.detect.onnx_recognition import Probe, obstacle, recognise
from phdtrack.errors import InputError
from phdtrack.types import F8, Detections, Frame

SIDE = 64
# Cells of 8, 16 and 32 pixels in the input.
CELLS = 84
# Of the one object: left, top, right, bottom in pixels.
BOX = [8.0, 16.0, 24.0, 56.0]
CENTRED = [16.0, 36.0, 16.0, 40.0]
Outputs = Mapping[str, np.ndarray]


def picture(side: int = SIDE) -> Frame:
    return Frame(1, 0.0, np.full((side, side, 3), 90, np.uint8))


def spread(count: int, columns: int, seed: int = 0) -> F8:
    """(1, count, columns) centres and sizes in pixels, and scores near 0."""
    rng = np.random.default_rng(seed)
    table = rng.uniform(0.0, 0.02, (1, count, columns))
    table[0, :, :2] = rng.uniform(0, SIDE, (count, 2))
    table[0, :, 2:4] = rng.uniform(2, 20, (count, 2))
    return table


def points(table: F8, first: int, count: int, visible: bool) -> None:
    """Put body points in pixels into the columns from ``first`` on."""
    rng = np.random.default_rng(1)
    width = 3 if visible else 2
    numbers = rng.uniform(0, SIDE, (table.shape[1], count, width))
    if visible:
        numbers[..., 2] = rng.uniform(0, 0.3, numbers.shape[:2])
    table[0, :, first : first + count * width] = numbers.reshape(table.shape[1], -1)


def first_row(table: F8, *numbers: float) -> F8:
    table[0, 0, : len(numbers)] = numbers
    return table


def turned(table: F8) -> F8:
    return table.transpose(0, 2, 1)


def pose() -> Outputs:
    table = spread(CELLS, 56)
    points(table, 5, 17, visible=True)
    return {"output0": turned(first_row(table, *CENTRED, 0.9))}


def pose_of_two_classes() -> Outputs:
    table = spread(CELLS, 4 + 2 + 8)
    points(table, 6, 4, visible=False)
    return {"output0": turned(first_row(table, *CENTRED, 0.9, 0.1))}


def face() -> Outputs:
    table = spread(CELLS, 20)
    points(table, 5, 5, visible=True)
    return {"output0": turned(first_row(table, *CENTRED, 0.9))}


def masks() -> Outputs:
    table = spread(120, 116)
    table[0, :, 84:] = np.random.default_rng(2).normal(0, 1, (120, 32))
    return {
        "output0": turned(first_row(table, *CENTRED, 0.9)),
        "output1": np.zeros((1, 32, 16, 16)),
    }


def pose_of_v7() -> Outputs:
    table = spread(3 * CELLS, 57)
    table[0, :, 5] = 1.0
    points(table, 6, 17, visible=True)
    return {"output": first_row(table, *CENTRED, 0.9)}


def face_of_v5() -> Outputs:
    table = spread(3 * CELLS, 16)
    points(table, 5, 5, visible=False)
    table[0, :, 15] = 1.0
    return {"output": first_row(table, *CENTRED, 0.9)}


def face_with_the_class_last() -> Outputs:
    table = spread(3 * CELLS, 21)
    points(table, 5, 5, visible=True)
    table[0, :, 20] = 1.0
    return {"output": first_row(table, *CENTRED, 0.9)}


def masks_of_v5() -> Outputs:
    table = spread(3 * CELLS, 117)
    table[0, :, 85:] = np.random.default_rng(2).normal(0, 1, (3 * CELLS, 32))
    table[0, :, 5] = 1.0
    return {"output0": first_row(table, *CENTRED, 0.9), "output1": np.zeros((1, 32, 16, 16))}


def shares(table: F8) -> F8:
    table[0, :, :4] /= SIDE
    return table


def rtdetr_rows() -> Outputs:
    table = spread(300, 6)
    table[0, :, 5] = np.arange(300) % 3
    return {"output0": shares(first_row(table, *CENTRED, 0.9, 0))}


def rtdetr_table() -> Outputs:
    return {"output0": shares(first_row(spread(300, 84), *CENTRED, 0.9))}


def yolox() -> Outputs:
    """Undecoded, as exported without an option."""
    table = spread(CELLS, 25)
    table[0, :, :4] = np.random.default_rng(3).normal(0, 0.5, (CELLS, 4))
    # The cell of 16 pixels at (1, 2), behind 64 of 8 pixels.
    table[0, 64 + 4 * 2 + 1, :6] = [0.0, 0.25, np.log(1.0), np.log(2.5), 0.9, 1.0]
    return {"output": table}


def yolox_decoded() -> Outputs:
    table = spread(CELLS, 25)
    return {"output": first_row(table, *CENTRED, 0.9, 1.0)}


def yolov6() -> Outputs:
    table = spread(CELLS, 25)
    table[0, :, 4] = 1.0
    return {"outputs": first_row(table, *CENTRED, 1.0, 0.9)}


def rows_of_v8() -> Outputs:
    """As TensorFlow lays them."""
    return {"output0": first_row(spread(CELLS, 84), *CENTRED, 0.9)}


def final_pose() -> Outputs:
    table = spread(300, 57)
    points(table, 6, 17, visible=True)
    table[0, :, 2:4] += table[0, :, :2]
    table[0, :, 5] = 0.0
    return {"output0": first_row(table, *BOX, 0.9)}


def yolov7_end_to_end() -> Outputs:
    return {"output": np.array([[0, *BOX, 0, 0.9]])}


def ssd_of_caffe() -> Outputs:
    rows = np.zeros((1, 1, 20, 7))
    rows[0, 0, 0] = [0, 0, 0.9, *np.divide(BOX, SIDE)]
    return {"detection_out": rows}


def corners_of_all_classes(count: int) -> F8:
    boxes = spread(count, 4)
    boxes[..., 2:] += boxes[..., :2]
    return first_row(boxes, *BOX)


def yolo_nas() -> Outputs:
    scores = np.random.default_rng(4).uniform(0, 0.02, (1, 1344, 80))
    scores[0, 0, 0] = 0.9
    return {"boxes": corners_of_all_classes(1344), "scores": scores}


def ssd() -> Outputs:
    """Probabilities of all classes, of which the first means the background."""
    scores = np.full((1, 3000, 21), 0.001)
    scores[..., 0] = 0.98
    scores[0, 0] = [0.1, 0.9, *[0.0] * 19]
    return {"scores": scores, "boxes": corners_of_all_classes(3000) / SIDE}


def mmdetection() -> Outputs:
    dets = np.zeros((1, 20, 5))
    dets[0, 0] = [*BOX, 0.9]
    return {"dets": dets, "labels": np.zeros((1, 20), np.int64)}


def detr_with_probabilities() -> Outputs:
    scores = np.full((1, 50, 5), 0.01)
    scores[..., 4] = 0.96
    scores[0, 0] = [0.9, 0.0, 0.0, 0.0, 0.1]
    return {"scores": scores, "pred_boxes": shares(first_row(spread(50, 4), *CENTRED))}


def yolov9() -> Outputs:
    """Two tables of one shape: that of the auxiliary branch, and the main one."""
    auxiliary = turned(first_row(spread(CELLS, 24), *CENTRED[::-1], 0.6))
    main = turned(first_row(spread(CELLS, 24), *CENTRED, 0.9))
    return {"output0": auxiliary, "output1": main}


def tensorflow_2() -> Outputs:
    """With the outputs of the model zoo, in their order."""
    boxes = np.zeros((1, 10, 4))
    boxes[0, 0] = np.divide([BOX[1], BOX[0], BOX[3], BOX[2]], SIDE)
    scores = np.zeros((1, 10))
    scores[0, 0] = 0.9
    return {
        "detection_anchor_indices": np.zeros((1, 10)),
        "detection_boxes": boxes,
        "detection_classes": np.zeros((1, 10)),
        "detection_multiclass_scores": np.full((1, 10, 3), 0.1),
        "detection_scores": scores,
        "num_detections": np.array([10.0]),
        "raw_detection_boxes": np.zeros((1, 50, 4)),
        "raw_detection_scores": np.zeros((1, 50, 3)),
    }


def paddle() -> Outputs:
    rows = np.zeros((30, 6))
    rows[0] = [0, 0.9, *BOX]
    return {"multiclass_nms3_0.tmp_0": rows, "multiclass_nms3_0.tmp_2": np.array([30])}


def final_rows_of_all_pictures() -> Outputs:
    rows = np.zeros((30, 6))
    rows[0] = [*BOX, 0.9, 0]
    return {"output": rows}


def cell_places(boxes_per_cell: int = 1) -> F8:
    """(N, 2) the middles of the cells of 8, 16 and 32 pixels."""
    places = []
    for side in (8, 16, 32):
        top, left = np.mgrid[0 : SIDE // side, 0 : SIDE // side]
        middles = np.stack([left, top], axis=-1).reshape(-1, 2) * side + side / 2
        places.append(np.tile(middles, (boxes_per_cell, 1)))
    return np.concatenate(places)


def cell_corners(columns: int) -> F8:
    """(1, CELLS, columns) corners of a box around each cell, and scores near 0."""
    table = spread(CELLS, columns)
    size = np.random.default_rng(6).uniform(2, 12, (2, CELLS, 2))
    table[0, :, :2] = cell_places() - size[0]
    table[0, :, 2:4] = cell_places() + size[1]
    return table


def rtmdet() -> Outputs:
    """Rows of corners and scores, as PicoDet has them, too."""
    return {"output": first_row(cell_corners(84), *BOX, 0.9)}


def rtmdet_of_three_classes() -> Outputs:
    return {"output": first_row(cell_corners(7), *BOX, 0.9)}


def corners_turned() -> Outputs:
    """The shape of a YOLO v8: YOLO v9 and others of LibreYOLO."""
    return {"output": turned(first_row(cell_corners(24), *BOX, 0.9))}


def ssd_turned() -> Outputs:
    """Boxes of several shapes for each place."""
    table = np.concatenate([corners_of_all_classes(2000), spread(2000, 24)[..., 4:]], axis=2)
    return {"output": turned(first_row(table, *BOX, 0.9))}


def efficientdet() -> Outputs:
    """The best of all boxes, with suppression left out. Rows without a class have the number -1."""
    rows = np.concatenate([corners_of_all_classes(5000), spread(5000, 6)[..., 4:]], axis=2)
    rows[0, :, 5] = np.arange(5000) % 7 - 1
    rows[0, 7, 4] = 0.95
    rows[0, 1] = [*np.add(BOX, 0.5), 0.8, 0]
    return {"output": first_row(rows, *BOX, 0.9, 0)}


def scores_with_an_axis() -> Outputs:
    """RTMDet's boxes, scores and classes before suppression."""
    scores = np.full((1, CELLS, 1), 0.01)
    scores[0, 0] = 0.9
    labels = np.arange(CELLS)[None] % 5
    return {"a": first_row(cell_corners(4), *BOX), "b": scores, "c": labels}


def centres_with_labels() -> Outputs:
    scores = np.full((1, 50), 0.01)
    scores[0, 0] = 0.9
    boxes = first_row(spread(50, 4), *CENTRED)
    return {"boxes": boxes, "scores": scores, "labels": np.arange(50)[None] % 5}


def yolo_nas_with_names_of_detr() -> Outputs:
    outputs = yolo_nas()
    return {"pred_logits": outputs["scores"], "pred_boxes": outputs["boxes"]}


# Outputs, what they are read as, and whether that is a guess.
RIGHT = [
    (pose, "YOLO v8 and later", False),
    (pose_of_two_classes, "YOLO v8 and later", False),
    (face, "YOLO v8 and later", False),
    (masks, "YOLO v8 and later", False),
    (pose_of_v7, "YOLO v5 and v7", False),
    (face_of_v5, "YOLO v5 and v7", False),
    (face_with_the_class_last, "YOLO v5 and v7", False),
    (masks_of_v5, "YOLO v5 and v7", False),
    (rtdetr_rows, "RT-DETR", False),
    (rtdetr_table, "RT-DETR", True),
    (yolox, "YOLOX", False),
    (yolox_decoded, "YOLOX", True),
    (yolov6, "YOLO v6", False),
    (rows_of_v8, "YOLO v8 and later", True),
    (final_pose, "final boxes", False),
    (yolov7_end_to_end, "YOLO v7 with suppression", False),
    (ssd_of_caffe, "SSD", False),
    (yolo_nas, "SSD or YOLO-NAS", True),
    (mmdetection, "MMDetection", False),
    (yolov9, "YOLO v8 and later", False),
    (tensorflow_2, "TensorFlow's boxes", False),
    (paddle, "PaddleDetection", False),
    (final_rows_of_all_pictures, "final boxes", False),
    (detr_with_probabilities, "DETR", False),
    (rtmdet, "corners and scores", True),
    (rtmdet_of_three_classes, "corners and scores", True),
    (corners_turned, "corners and scores", True),
    (ssd_turned, "corners and scores", True),
    (efficientdet, "boxes before suppression", True),
    (scores_with_an_axis, "boxes, scores and labels (left", False),
    (centres_with_labels, "boxes, scores and labels (centre", True),
    (yolo_nas_with_names_of_detr, "SSD or YOLO-NAS", True),
]


def detections(path: Path, outputs: Outputs, **more: object) -> tuple[OnnxDetector, Detections]:
    networks.answering(path, outputs, side=SIDE)
    detector = OnnxDetector(str(path), **more)  # type: ignore[arg-type]
    return detector, detector(picture())


@pytest.mark.parametrize(
    ("outputs", "name", "guessed"), [pytest.param(*one, id=one[0].__name__) for one in RIGHT]
)
def test_one_object_is_found_without_metadata(
    outputs: object, name: str, guessed: bool, tmp_path: Path
) -> None:
    detector, found = detections(tmp_path / "net.onnx", outputs())  # type: ignore[operator]
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)
    np.testing.assert_allclose(found.confidence, [0.9], atol=1e-6)
    assert found.class_id.tolist() == [0]
    layout = detector.output_layout
    assert layout.name.startswith(name)
    assert layout.guessed == guessed
    # That 80 classes have the names of COCO is another guess.
    told = [sentence for sentence in guesses(detector) if "as in COCO" not in sentence]
    assert bool(told) == (guessed or bool(layout.input_doubt))
    assert len(guesses(detector)) - len(told) == (layout.classes == 80)


def test_class_that_means_background_keeps_its_number(tmp_path: Path) -> None:
    detector, found = detections(tmp_path / "net.onnx", ssd())
    assert (found.class_id.tolist(), len(found)) == ([1], 1)
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)
    assert "class 0 means no object" in detector.output_layout.evidence


def test_metadata_and_option_name_an_rtdetr(tmp_path: Path) -> None:
    """Boxes that could be corners: the network gives nothing but rows of zeros."""
    table = np.zeros((1, 300, 6))
    frame = picture()
    head = {"head": "RTDETRDecoder"}
    described = {"description": "Ultralytics rtdetr-l model trained on coco.yaml"}
    for metadata, options in ((head, {}), (described, {}), ({}, {"layout": "rtdetr"})):
        path = networks.answering(tmp_path / "net.onnx", {"output0": table}, metadata, SIDE)
        detector = OnnxDetector(str(path), **options)  # type: ignore[arg-type]
        assert detector.output_layout.name.startswith("RT-DETR")
        assert not detector.output_layout.guessed
        assert len(detector(frame)) == 0
    path = networks.answering(tmp_path / "net.onnx", {"output0": table}, {}, SIDE)
    assert OnnxDetector(str(path)).output_layout.name.startswith("final boxes")
    assert "This is a guess" in guesses(OnnxDetector(str(path)))[0]


def test_chosen_layout_overrides_the_recognised_one(tmp_path: Path) -> None:
    path = networks.answering(tmp_path / "net.onnx", yolox_decoded(), side=SIDE)
    for layout, pixels, name in (
        ("", "bytes", "YOLOX"),
        ("yolov5", "unit", "YOLO v5"),
        ("yolox", "bytes", "YOLOX"),
    ):
        detector = OnnxDetector(str(path), layout=layout)
        assert (detector.output_layout.pixels, detector.output_layout.guessed) == (
            pixels,
            not layout,
        )
        assert detector.output_layout.name.startswith(name)
        np.testing.assert_allclose(detector(picture()).xyxy, [BOX], atol=1e-3)


def test_yolox_takes_blue_first_unless_told_otherwise(tmp_path: Path) -> None:
    path = networks.answering(tmp_path / "net.onnx", yolox(), side=SIDE)
    image = np.zeros((SIDE, SIDE, 3), np.uint8)
    image[..., 0] = 200
    for options, pixel in (
        ({}, [200, 0, 0]),
        ({"pixels": "bytes"}, [0, 0, 200]),
        ({"pixels": "unit", "bgr": True}, [200 / 255, 0, 0]),
    ):
        detector = OnnxDetector(str(path), **options)  # type: ignore[arg-type]
        taken = detector.letterbox(image).tensor[:, 5, 5]
        np.testing.assert_allclose(taken, pixel, atol=1e-5)


def test_paddle_gets_the_size_and_the_scale_of_its_input(tmp_path: Path) -> None:
    path = networks.answering(
        tmp_path / "net.onnx", paddle(), side=SIDE, pairs=("im_shape", "scale_factor")
    )
    detector = make_detector(f"onnx:{path}", pixels="signed")
    np.testing.assert_allclose(detector(picture()).xyxy, [BOX], atol=1e-3)
    assert isinstance(detector, OnnxDetector)
    white = np.full((SIDE, SIDE, 3), 255, np.uint8)
    np.testing.assert_allclose(detector.letterbox(white).tensor, 1.0)
    np.testing.assert_allclose(detector.letterbox(0 * white).tensor, -1.0)


@pytest.mark.parametrize("number", [7.0, np.nan])
def test_one_bad_row_does_not_change_the_unit_of_the_others(number: float, tmp_path: Path) -> None:
    boxes = shares(first_row(spread(300, 4), *CENTRED))
    boxes[0, 5] = number
    scores = np.full((1, 300, 3), -6.0)
    scores[0, 0, 0] = 3.0
    found = detections(tmp_path / "net.onnx", {"dets": boxes, "labels": scores})[1]
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)


def test_guess_is_reported_once_with_the_cure(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = networks.answering(tmp_path / "net.onnx", yolo_nas(), side=SIDE)
    with caplog.at_level(logging.WARNING):
        detector = make_detector(f"onnx:{path}", max_width=32)
        for _ in range(3):
            detector(picture())
        # The names of COCO, and the layout.
        assert len(caplog.messages) == 2
        assert [*guesses(detector)] == caplog.messages
        sentence = caplog.messages[1]
        other = make_detector(f"onnx:{path}")
        guesses(other)
        other(picture())
        assert len(caplog.messages) == 2
    assert "read as SSD or YOLO-NAS" in sentence
    assert "boxes (1, 1344, 4), scores (1, 1344, 80)" in sentence
    assert "detector.layout" in sentence


def rotated() -> Outputs:
    table = spread(300, 7)
    table[0, :, 5] = 1.0
    table[0, :, 6] = np.linspace(-0.7, 2.3, 300)
    return {"output0": table}


def rotated_of_v8() -> Outputs:
    table = spread(CELLS, 20)
    table[0, :, 19] = np.linspace(-0.7, 2.3, CELLS)
    return {"output0": turned(table)}


def rotated_alike() -> Outputs:
    """In a grey picture all angles may be alike, and between 0 and 1."""
    table = spread(CELLS, 20)
    table[0, :, 19] = 0.78
    return {"output0": turned(table)}


def without_sigmoid() -> Outputs:
    table = spread(120, 84)
    table[0, :, 4:] = np.random.default_rng(5).normal(-5, 2, (120, 80))
    return {"output0": turned(table)}


def heads() -> Outputs:
    return {"a": np.zeros((1, 3, 8, 8, 85)), "b": np.zeros((1, 3, 4, 4, 85))}


def heads_of_v8() -> Outputs:
    return {"a": np.zeros((1, 144, 8, 8)), "b": np.zeros((1, 144, 4, 4))}


def relative_boxes() -> Outputs:
    table = spread(200, 85)
    table[0, :, 2:4] = -1.0
    return {"output": table}


def no_numbers() -> Outputs:
    return {"output0": np.full((1, 84, 120), np.nan)}


@pytest.mark.parametrize(
    ("outputs", "reason"),
    [
        (rotated, "Rotated boxes"),
        (rotated_of_v8, "Rotated boxes"),
        (rotated_alike, "Rotated boxes"),
        (without_sigmoid, "export the scores with their sigmoid"),
        (heads, "heads before their boxes are decoded"),
        (heads_of_v8, "heads before their boxes are decoded"),
        (relative_boxes, "Sizes are negative"),
        (no_numbers, "float16 may be too small"),
    ],
)
def test_unusable_outputs_are_refused_with_a_reason(
    outputs: object, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="are not recognised: ") as error:
        detections(tmp_path / "net.onnx", outputs())  # type: ignore[operator]
    assert reason in str(error.value)
    assert " from " in str(error.value)
    assert "Try detector.layout=yolov5" in str(error.value)


def test_names_do_not_make_an_angle_a_further_number(tmp_path: Path) -> None:
    names = {"names": str(["x"] * 15)}
    path = networks.answering(tmp_path / "net.onnx", rotated_of_v8(), names, SIDE)
    with pytest.raises(InputError, match="Rotated boxes"):
        OnnxDetector(str(path))


def test_score_above_one_is_an_error(tmp_path: Path) -> None:
    """Body points are read as scores because the user says so."""
    outputs = {"output0": without_sigmoid()["output0"] + 20.0}
    path = networks.answering(tmp_path / "net.onnx", outputs, side=SIDE)
    detector = OnnxDetector(str(path), layout="yolov8")
    with pytest.raises(InputError, match=r"net\.onnx, frame 1: expected scores from 0 to 1, got"):
        detector(picture())


def test_names_that_fit_no_values_are_no_evidence(tmp_path: Path) -> None:
    names = {"names": str(["x"] * 40)}
    path = networks.answering(tmp_path / "net.onnx", pose_of_v7(), names, SIDE)
    detector = OnnxDetector(str(path))
    found = detector(picture())
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)
    np.testing.assert_allclose(found.confidence, [0.9], atol=1e-6)
    assert "name 40 classes, but boxes have scores of 1" in guesses(detector)[0]


shapes = st.lists(st.integers(0, 9), min_size=0, max_size=4)


@given(data=st.data())
def test_any_outputs_are_read_or_not_recognised(data: st.DataObject) -> None:
    names = data.draw(
        st.lists(
            st.sampled_from(["boxes", "scores", "labels", "dets", "num", "a", "b"]),
            min_size=1,
            max_size=4,
            unique=True,
        )
    )
    rng = np.random.default_rng(data.draw(st.integers(0, 9)))
    outputs = dict[str, np.ndarray]()
    for name in names:
        shape = [1, *data.draw(shapes)]
        kind = data.draw(st.sampled_from(["share", "pixel", "whole", "zero", "nan"]))
        values = {
            "share": rng.uniform(0, 1, shape),
            "pixel": rng.uniform(-3, 640, shape),
            "whole": rng.integers(0, 3, shape),
            "zero": np.zeros(shape),
            "nan": np.full(shape, np.nan),
        }
        outputs[name] = values[kind]
    layout = data.draw(st.sampled_from(["", *LAYOUTS]))
    known = data.draw(st.integers(0, 3))
    probe = Probe(outputs, SIDE, SIDE, True, layout, known, "", "", False)
    found = recognise(probe)
    if found is None:
        assert isinstance(obstacle(probe), str)
        return
    arrays = [*outputs.values()]
    if found.batched:
        arrays = of_picture(arrays, 0)
    boxes, scores, labels = found.decode(arrays)
    assert boxes.shape == (len(scores), 4)
    assert len(labels) == len(scores)


def test_inverted_boxes_are_an_error(tmp_path: Path) -> None:
    outputs = {"output0": rtdetr_rows()["output0"].copy()}
    outputs["output0"][0, :20, 4] = 0.8
    with pytest.raises(InputError, match="most boxes have right left of left"):
        detections(tmp_path / "net.onnx", outputs, layout="end2end")


def test_coco_names_fit_networks_that_count_to_ninety(tmp_path: Path) -> None:
    scores = np.full((1, 300, 91), -6.0)
    scores[0, 0, [1, 90]] = [3.0, 2.0]
    outputs = {"dets": shares(first_row(spread(300, 4), *CENTRED)), "labels": scores}
    detector, found = detections(tmp_path / "net.onnx", outputs, classes="person")
    assert (detector.class_names[1], detector.class_names[90]) == ("person", "toothbrush")
    assert len(detector.class_names) == 80
    assert found.class_id.tolist() == [1]


def test_rfdetr_with_four_scores_keeps_its_boxes(tmp_path: Path) -> None:
    """Boxes and scores of three classes and the background have one shape."""
    scores = np.full((1, 300, 4), -6.0)
    scores[0, 0, 2] = 3.0
    outputs = {"dets": shares(first_row(spread(300, 4), *CENTRED)), "labels": scores}
    found = detections(tmp_path / "net.onnx", outputs)[1]
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)
    assert found.class_id.tolist() == [2]


def test_small_yolo_is_not_taken_for_final_boxes(tmp_path: Path) -> None:
    """The only class has a score of exactly 1 in every row."""
    table = spread(3 * CELLS, 6)
    table[0, :, 5] = 1.0
    detector, found = detections(tmp_path / "net.onnx", {"output": first_row(table, *CENTRED, 0.9)})
    assert detector.output_layout.name.startswith("YOLO v5")
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)


@pytest.mark.parametrize("share", [0.3, 1.0, 3.0])
def test_large_boxes_of_a_yolo_stay_centred(share: float, tmp_path: Path) -> None:
    """Most of them would keep left before right as corners, too."""
    table = spread(CELLS, 24)
    table[0, :, :2] = cell_places()
    table[0, :, 2:4] = np.random.default_rng(7).uniform(0.8, 1.2, (CELLS, 2)) * share * SIDE
    table[0, 0, :5] = [*CENTRED, 0.9]
    detector, found = detections(tmp_path / "net.onnx", {"output0": turned(table)})
    assert detector.output_layout.name.startswith("YOLO v8")
    np.testing.assert_allclose(found.xyxy, [BOX], atol=1e-3)


def detr(boxes: str, table: str, background: float = -9.0) -> Outputs:
    scores = np.full((1, 100, 5), -6.0)
    scores[0, 0, 0] = 3.0
    scores[0, 1:, 4] = background
    return {table: scores, boxes: shares(first_row(spread(100, 4), *CENTRED))}


@pytest.mark.parametrize(
    ("outputs", "pixels", "stretch", "told"),
    [
        (detr("pred_boxes", "logits"), "unit", True, "Deformable DETR"),
        (detr("pred_boxes", "logits", 9.0), "imagenet", False, ""),
        (detr("dets", "labels"), "imagenet", True, ""),
        (rtdetr_rows(), "unit", True, ""),
        (ssd_of_caffe(), "unit", True, "MobileNet-SSD"),
        (mmdetection(), "imagenet", False, "RTMDet"),
        (paddle(), "unit", True, "PP-YOLOE"),
        (yolov9(), "unit", False, ""),
    ],
)
def test_frames_go_in_as_such_networks_are_trained(
    outputs: Outputs, pixels: str, stretch: bool, told: str, tmp_path: Path
) -> None:
    path = networks.answering(tmp_path / "net.onnx", outputs, side=SIDE)
    detector = OnnxDetector(str(path))
    assert (detector.output_layout.pixels, detector.output_layout.stretch) == (pixels, stretch)
    wide = np.full((SIDE // 2, SIDE, 3), 255, np.uint8)
    grey_rows = len({float(row.max()) for row in detector.letterbox(wide).tensor[0]}) > 1
    assert grey_rows != stretch
    sentences = guesses(detector)
    assert bool(sentences) == bool(told)
    if told:
        assert told in sentences[0]
        assert "Frames go in" in sentences[0]
        chosen = OnnxDetector(str(path), pixels="imagenet")
        assert not guesses(chosen)
    other = OnnxDetector(str(path), stretch=not stretch)
    grey_rows = len({float(row.max()) for row in other.letterbox(wide).tensor[0]}) > 1
    assert grey_rows == stretch


def test_bgr_false_means_red_first(tmp_path: Path) -> None:
    path = networks.answering(tmp_path / "net.onnx", yolox(), side=SIDE)
    image = np.zeros((SIDE, SIDE, 3), np.uint8)
    image[..., 0] = 200
    detector = make_detector(f"onnx:{path}", bgr=False)
    assert isinstance(detector, OnnxDetector)
    np.testing.assert_allclose(detector.letterbox(image).tensor[:, 5, 5], [0, 0, 200])
    with pytest.raises(InputError, match="expected true or false, got 'yes'"):
        make_detector(f"onnx:{path}", bgr="yes")


@pytest.mark.parametrize(
    "names", ['{"0": "cat", "1": "dog"}', "{0: 'cat', 1: 'dog'}", '["cat", "dog"]']
)
def test_class_names_in_json_are_read(names: str, tmp_path: Path) -> None:
    outputs = {"output0": turned(first_row(spread(CELLS, 6), *CENTRED, 0.1, 0.9))}
    path = networks.answering(tmp_path / "net.onnx", outputs, {"names": names}, SIDE)
    detector = OnnxDetector(str(path), classes="dog")
    assert detector.class_names == {0: "cat", 1: "dog"}
    assert detector(picture()).class_id.tolist() == [1]
