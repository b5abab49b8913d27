"""Networks in ONNX files: every layout of outputs, letterboxing, suppression, classes, batches, and
what is refused.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

import networks
from phdtrack.detect import onnx_layouts
from phdtrack.detect.base import class_names, detect_all
from phdtrack.detect.detectors import detector_parameters, make_detector
from phdtrack.detect.onnx import OnnxDetector
from phdtrack.errors import InputError
from phdtrack.types import Frame

BOXES = {0: (20, 30, 60, 80), 1: (100, 10, 150, 50), 2: (70, 90, 120, 110)}
THREE = {
    "names": "{0: 'person', 1: 'car', 2: 'bus'}",
    "stride": "32",
    "imgsz": "[96, 128]",
    "task": "detect",
}
Shapes = dict[str, tuple[int, ...]]
SHAPES: dict[str, tuple[object, ...]] = {
    "torchvision": (3, 96, 128),
    "tensorflow": ("N", 96, 128, 3),
}


def found_by(
    path: Path, frame: Frame, **parameters: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    found = make_detector(f"onnx:{path}", **parameters)(frame)  # type: ignore[arg-type]
    return found.xyxy, found.confidence, found.class_id


@pytest.mark.parametrize("layout", networks.LAYOUTS)
def test_each_layout_gives_boxes_to_a_pixel(layout: str, tmp_path: Path) -> None:
    kind = "uint8" if layout == "tensorflow" else "float"
    metadata = THREE if layout == "queries" else {}
    path = networks.write(
        tmp_path / "net.onnx", layout, SHAPES.get(layout, ("N", 3, 96, 128)), kind, metadata
    )
    # The picture is larger than the input and of another shape: it is shrunk to 128x77, and a pixel
    # there is 1.6 here.
    xyxy, confidence, class_id = found_by(path, networks.scene(200, 120, BOXES))
    np.testing.assert_allclose(xyxy, networks.truth(BOXES), atol=1.0)
    assert class_id.tolist() == [0, 1, 2]
    assert (np.diff(confidence) < 0).all()
    assert ((confidence > 0.6) & (confidence <= 1)).all()
    assert len(found_by(path, networks.scene(200, 120, {}))[0]) == 0
    # At the input's own size nothing is lost.
    same = {0: (3, 5, 30, 40), 1: (60, 1, 128, 50), 2: (0, 60, 33, 96)}
    np.testing.assert_allclose(
        found_by(path, networks.scene(128, 96, same))[0], networks.truth(same), atol=2e-5
    )


@pytest.fixture(scope="module")
def fixed(tmp_path_factory: pytest.TempPathFactory) -> OnnxDetector:
    path = networks.write(
        tmp_path_factory.mktemp("fixed") / "net.onnx", "yolov8", ("N", 3, 96, 128), metadata=THREE
    )
    return OnnxDetector(str(path))


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> OnnxDetector:
    path = networks.write(
        tmp_path_factory.mktemp("free") / "net.onnx", "end2end", ("N", 3, "H", "W"), metadata=THREE
    )
    return OnnxDetector(str(path), size=192)


@given(data=st.data(), width=st.integers(17, 400), height=st.integers(17, 400))
def test_padding_is_undone_for_any_frame_size(
    data: st.DataObject, width: int, height: int, fixed: OnnxDetector, free: OnnxDetector
) -> None:
    sides = [
        sorted(data.draw(st.lists(st.integers(0, side), min_size=2, max_size=2)))
        for side in (width, height)
    ]
    (left, right), (top, bottom) = (
        [a, max(b, min(a + 12, side))] for (a, b), side in zip(sides, (width, height), strict=True)
    )
    left = min(left, right - 8)
    top = min(top, bottom - 8)
    frame = networks.scene(width, height, {1: (left, top, right, bottom)})
    for detector, size in ((fixed, (128, 96)), (free, (192, 192))):
        factor = min(size[0] / width, size[1] / height)
        if min(right - left, bottom - top) * factor < 2:
            continue
        found = detector(frame)
        assert found.class_id.tolist() == [1]
        # Edges are found to a pixel of the input.
        np.testing.assert_allclose(
            found.xyxy[0], [left, top, right, bottom], atol=1.0 / min(factor, 1.0) + 0.01
        )
        assert (found.xyxy >= 0).all()
        assert (found.xyxy <= [width, height, width, height]).all()


def test_free_input_size_is_padded_to_the_stride(free: OnnxDetector) -> None:
    placed = free.letterbox(networks.scene(400, 200, {}).image)
    assert (placed.size.tolist(), placed.tensor.shape) == ([192.0, 96.0], (3, 96, 192))
    assert free.letterbox(networks.scene(101, 400, {}).image).size.tolist() == [64.0, 192.0]


@pytest.mark.parametrize(
    ("kind", "layout"),
    [
        ("float16", "yolov8"),
        ("float16", "rfdetr"),
        ("float16", "pose"),
        ("float16", "rtdetr-rows"),
        ("uint8", "yolov5"),
        ("uint8", "masks"),
    ],
)
def test_other_number_types_give_the_same_boxes(kind: str, layout: str, tmp_path: Path) -> None:
    outputs = "float16" if kind == "float16" else ""
    plain = networks.write(tmp_path / "plain.onnx", layout)
    other = networks.write(tmp_path / "other.onnx", layout, kind=kind, outputs=outputs)
    frame = networks.scene(256, 180, BOXES)
    for one, two, least in zip(
        found_by(plain, frame), found_by(other, frame), (0.1, 2e-3, 0), strict=True
    ):
        np.testing.assert_allclose(one, two, atol=least)


def test_overlapping_boxes_of_a_class_are_suppressed(
    tmp_path: Path,
) -> None:
    path = networks.write(tmp_path / "net.onnx", "yolov5")
    frame = networks.scene(128, 96, {0: (10, 10, 60, 60), 1: (64, 10, 110, 60)})
    assert [len(found_by(path, frame, overlap=overlap)[0]) for overlap in (0.7, 0.95, 1.0)] == [
        2,
        4,
        4,
    ]
    confidence = found_by(path, frame, overlap=1.0, confidence=0.8)[1]
    np.testing.assert_allclose(confidence, [0.9, 0.81, 0.8], atol=1e-6)
    apart = networks.write(tmp_path / "end.onnx", "end2end")
    assert len(found_by(apart, frame, overlap=0.0)[0]) == 2


@pytest.mark.parametrize(
    "shape", [("N", 3, 96, 128), (1, 3, 96, 128), (4, 3, 96, 128), ("N", 3, "H", "W")]
)
def test_batches_give_the_same_as_single_frames(shape: tuple[object, ...], tmp_path: Path) -> None:
    path = networks.write(tmp_path / "net.onnx", "yolov8", shape)
    frames = [
        networks.scene(200, 120, {k % 3: (5 * k, 20, 5 * k + 40, 90)}, k + 1) for k in range(7)
    ]
    frames.append(networks.scene(90, 170, {0: (10, 20, 50, 90)}, 8))
    many = OnnxDetector(str(path), size=0, batch=3)
    assert many.batch_size == {"N": 3, 1: 1, 4: 4}[shape[0]]
    alone = [make_detector(f"onnx:{path}")(frame) for frame in frames]
    together = list(detect_all(many, iter(frames)))
    assert [frame.number for frame, *_ in together] == list(range(1, 9))
    for one, (_, other, _) in zip(alone, together, strict=True):
        assert len(one) == 1
        np.testing.assert_array_equal(one.xyxy, other.xyxy)
        np.testing.assert_array_equal(one.confidence, other.confidence)


@pytest.mark.parametrize(
    ("layout", "shape"),
    [
        (layout, shape)
        for layout in ("pose", "masks", "face", "rtdetr-rows", "yolox", "rfdetr")
        for shape in (("N", 3, 96, 128), (3, 3, 96, 128), ("N", 96, 128, 3), ("N", 3, "H", "W"))
        # An undecoded YOLOX has a fixed size.
        if layout != "yolox" or "H" not in shape
    ],
)
def test_layouts_with_all_axes_and_batches(
    layout: str, shape: tuple[object, ...], tmp_path: Path
) -> None:
    path = networks.write(tmp_path / "net.onnx", layout, shape)
    detector = OnnxDetector(str(path), batch=3, size=128 if "H" in shape else 0)
    assert detector.batch_size == 3
    moved = {code: tuple(np.add(box, 5)) for code, box in BOXES.items()}
    frames = [networks.scene(200, 120, BOXES, 1), networks.scene(200, 120, moved, 2)]  # type: ignore[arg-type]
    found = detector.detect_batch(frames)
    for one, boxes in zip(found, (BOXES, moved), strict=True):
        np.testing.assert_allclose(one.xyxy, networks.truth(boxes), atol=1.6)  # type: ignore[arg-type]
        assert one.class_id.tolist() == [0, 1, 2]


def test_frames_before_an_error_are_detected(
    fixed: OnnxDetector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fixed, "batch", 4)

    def frames() -> object:
        yield from (networks.scene(128, 96, BOXES, k) for k in range(1, 7))
        raise InputError("the video ends here")

    seen = list[int]()
    with pytest.raises(InputError, match="ends here"):
        seen.extend(frame.number for frame, *_ in detect_all(fixed, frames()))  # type: ignore[arg-type]
    assert seen == [1, 2, 3, 4, 5, 6]


def test_classes_are_chosen_by_name_or_number(tmp_path: Path) -> None:
    path = networks.write(tmp_path / "net.onnx", metadata=THREE)
    frame = networks.scene(200, 120, BOXES)
    assert class_names(make_detector(f"onnx:{path}", max_width=100)) == {
        0: "person",
        1: "car",
        2: "bus",
    }
    assert found_by(path, frame, classes="Bus, 0")[2].tolist() == [0, 2]
    with pytest.raises(
        InputError, match=r"detector\.classes: the network has no class buss\. Did you mean bus\?"
    ):
        make_detector(f"onnx:{path}", classes="buss")
    silent = networks.write(tmp_path / "silent.onnx", metadata={"names": "{'a': 1"})
    assert class_names(make_detector(f"onnx:{silent}")) == {}
    assert found_by(silent, frame, classes="1")[2].tolist() == [1]
    with pytest.raises(InputError, match="does not name its classes: give their numbers"):
        make_detector(f"onnx:{silent}", classes="person")
    listed = networks.write(tmp_path / "listed.onnx", metadata={"names": "['a', 'b', 'c']"})
    assert class_names(make_detector(f"onnx:{listed}")) == {0: "a", 1: "b", 2: "c"}


def constant(
    path: Path,
    metadata: dict[str, str] | None = None,
    value: float = 0.0,
    channels: int = 3,
    **shapes: tuple[int, ...],
) -> Path:
    """A network that takes (1, 3, 64, 64) and gives arrays of these shapes with the same value
    everywhere.
    """
    nodes = [
        helper.make_node(
            "ConstantOfShape",
            [f"{name}.shape"],
            [name],
            value=helper.make_tensor("v", 1, [1], [value]),
        )
        for name in shapes
    ]
    sizes = [
        helper.make_tensor(f"{name}.shape", TensorProto.INT64, [len(shape)], shape)
        for name, shape in shapes.items()
    ]
    taken = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, channels, 64, 64))
    given = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in shapes.items()
    ]
    graph = helper.make_graph(nodes, "zeros", [taken], given, sizes)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata or {})
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize(
    ("shapes", "metadata", "more", "classes", "decode"),
    [
        ({"a": (1, 84, 8400)}, {}, {}, 80, onnx_layouts.grid),
        ({"a": (1, 25200, 85)}, {}, {}, 80, onnx_layouts.grid),
        ({"a": (1, 25200, 6)}, {}, {}, 1, onnx_layouts.grid),
        ({"a": (1, 25200, 85), "b": (1, 3, 80, 80, 85)}, {}, {}, 80, onnx_layouts.grid),
        # A small input: fewer rows than columns. Two classes, and one: six numbers that are no
        # end-to-end row.
        ({"a": (1, 84, 84)}, {"names": str(["x"] * 80)}, {}, 80, onnx_layouts.grid),
        ({"a": (1, 300, 6)}, {"names": "['x', 'y']"}, {}, 2, onnx_layouts.grid),
        ({"a": (1, 252, 6)}, {"names": "['x']"}, {}, 1, onnx_layouts.grid),
        ({"a": (1, 252, 6)}, {"names": "['x']"}, {"layout": "end2end"}, 1, onnx_layouts.end_to_end),
        (
            {"a": (1, 39, 84), "b": (1, 32, 16, 16)},
            {"names": "['x', 'y', 'z']", "task": "segment"},
            {},
            3,
            onnx_layouts.grid,
        ),
        ({"a": (1, 300, 84)}, {"names": str(["x"] * 80)}, {}, 80, onnx_layouts.grid),
        (
            {"logits": (1, 300, 91), "pred_boxes": (1, 300, 4), "last_hidden_state": (1, 300, 256)},
            {},
            {},
            91,
            onnx_layouts.queries,
        ),
        ({"a": (1, 300, 6)}, {"value": "0"}, {}, 0, onnx_layouts.end_to_end),
        ({"a": (1, 0, 6)}, {"value": "0", "names": "['x']"}, {}, 1, onnx_layouts.end_to_end),
        (
            {"a": (1, 300, 38), "b": (1, 32, 16, 16)},
            {"value": "0", "names": "['x']", "task": "segment"},
            {},
            1,
            onnx_layouts.end_to_end,
        ),
    ],
)
def test_layout_follows_from_shapes_and_metadata(
    shapes: dict[str, tuple[int, ...]],
    metadata: dict[str, str],
    more: dict[str, str],
    classes: int,
    decode: Callable[..., object],
    tmp_path: Path,
) -> None:
    path = constant(tmp_path / "net.onnx", metadata, float(metadata.get("value", "0.25")), **shapes)
    detector = OnnxDetector(str(path), **more)  # type: ignore[arg-type]
    layout = detector.output_layout
    assert (layout.classes, layout.decode.func) == (classes, decode)  # type: ignore[attr-defined]
    if classes == 80 and not metadata:
        assert (detector.class_names[0], detector.class_names[79]) == ("person", "toothbrush")


@pytest.mark.parametrize(
    ("shapes", "metadata"),
    [
        ({"a": (1, 1000)}, {}),
        ({"a": (1, 2, 3), "b": (1, 5, 6)}, {}),
        ({"boxes": (1, 5, 4)}, {"names": "['x', 'y']"}),
        ({"boxes": (1, 5, 4), "scores": (1, 80, 5)}, {}),
        # Corners of many boxes for each object, and scores of all classes: an SSD's, before its
        # suppression.
        ({"boxes": (1, 5, 4), "scores": (1, 5, 3)}, {}),
        # Logarithms of sizes: a YOLOX that is not decoded.
        ({"a": (1, 8400, 85)}, {"value": "-1"}),
        ({"a": (1, 9, 84)}, {"names": "['x', 'y', 'z', 'u']", "task": "obb"}),
    ],
)
def test_unknown_outputs_are_listed_with_supported_ones(
    shapes: Shapes, metadata: dict[str, str], tmp_path: Path
) -> None:
    path = constant(tmp_path / "net.onnx", metadata, float(metadata.get("value", 0)), **shapes)
    with pytest.raises(
        InputError,
        match=r"net\.onnx: the network's outputs are not recognised: .*Supported are \(1, 4",
    ) as error:
        OnnxDetector(str(path))
    assert "inputs: images tensor(float) (1, 3, 64, 64)" in str(error.value)
    for name, shape in shapes.items():
        assert f"{name} float32 {shape}" in str(error.value)


def test_invalid_networks_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = networks.write(tmp_path / "net.onnx")
    (tmp_path / "cut.onnx").write_bytes(whole.read_bytes()[:-300])
    (tmp_path / "text.onnx").write_text("no network")
    constant(tmp_path / "one.onnx", channels=1, a=(1, 84, 8400))
    for name, parameters, message in (
        (
            "onnx:cut.onnx",
            {},
            r"cut\.onnx: onnxruntime .* cannot run this network: .*Is it an ONNX file",
        ),
        ("onnx:text.onnx", {}, r"text\.onnx: onnxruntime .* cannot run this network"),
        ("onnx:none.onnx", {}, r"none\.onnx: there is no such file"),
        ("onnx:.", {}, "got a folder"),
        (
            "onnx:one.onnx",
            {},
            r"inputs are not supported: images tensor\(float\) \(1, 1, 64, 64\). The network must",
        ),
        (
            "onnx:net.onnx",
            {"size": 320},
            r"detector\.size: the network only takes pictures of 128x96 pixels",
        ),
        (
            "onnx:net.onnx",
            {"layout": "yolov9"},
            r"detector\.layout: expected yolov5, yolov8, yolox, end2end, rtdetr, got 'yolov9'",
        ),
        ("onnx:net.onnx", {"confidence": 2.0}, "confidence: expected a value at most 1"),
        (
            "onnx:net.onnx",
            {"confidense": 2.0},
            "no parameter 'confidense'. Did you mean confidence",
        ),
        (
            "yolo",
            {},
            "no detector 'yolo'. There are change, .*onnx:FILE, for its boxes --detections FILE",
        ),
        ("yolo11n.onnx", {}, r"no detector 'yolo11n\.onnx'\. Use onnx:yolo11n\.onnx"),
    ):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InputError, match=message):
            make_detector(name, **parameters)  # type: ignore[arg-type]
    assert "file" not in detector_parameters("onnx:net.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(
        InputError, match=r"needs the package onnxruntime\. pip install 'phdtrack\[onnx\]'"
    ):
        make_detector("onnx:net.onnx")


def test_pixels_are_scaled_as_in_training(tmp_path: Path) -> None:
    """Blue before red, stretched, and the mean of ImageNet: what is asked for is what goes in."""
    path = networks.write(tmp_path / "net.onnx", metadata=THREE)
    frame = networks.scene(200, 120, {0: (20, 30, 60, 80)})
    assert found_by(path, frame, bgr=True)[2].tolist() == [2]
    np.testing.assert_allclose(found_by(path, frame, stretch=True)[0], [[20, 30, 60, 80]], atol=1.3)
    red = OnnxDetector(str(path), stretch=True).letterbox(frame.image).tensor[:, 50, 25]
    means = np.array([0.485, 0.456, 0.406])
    deviations = np.array([0.229, 0.224, 0.225])
    np.testing.assert_allclose(red, [1, 0, 0], atol=1e-6)
    for pixels, value in (("bytes", red * 255), ("imagenet", (red - means) / deviations)):
        taken = (
            OnnxDetector(str(path), stretch=True, pixels=pixels)
            .letterbox(frame.image)
            .tensor[:, 50, 25]
        )
        np.testing.assert_allclose(taken, value, atol=1e-5)
