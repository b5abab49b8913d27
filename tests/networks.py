"""Small networks that find a red, a green and a blue blob in a picture, with the inputs and outputs
of usual detectors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from phdtrack.types import F8, Frame

TYPES = {
    "float": TensorProto.FLOAT,
    "float16": TensorProto.FLOAT16,
    "uint8": TensorProto.UINT8,
    "int64": TensorProto.INT64,
}
LAYOUTS = (
    "yolov8",
    "yolov5",
    "end2end",
    "queries",
    "torchvision",
    "rtdetr",
    "detr",
    "rfdetr",
    "tensorflow",
    "pose",
    "masks",
    "face",
    "rtdetr-rows",
    "yolox",
)
# The input of networks that describe crops.
CROPS = ("N", 3, 64, 32)
# Rows that say nothing, after those of blobs.
PADDING = 18


class Graph:
    """Nodes one after the other; arguments that are not names are constants."""

    def __init__(self) -> None:
        self.nodes = list[onnx.NodeProto]()
        self.constants = list[onnx.TensorProto]()

    def __call__(self, op: str, *inputs: Any, outputs: int = 1, **attributes: Any) -> Any:
        names = [self.named(one) for one in inputs]
        made = [f"{op}{len(self.nodes)}_{k}" for k in range(outputs)]
        self.nodes.append(helper.make_node(op, names, made, **attributes))
        return made[0] if outputs == 1 else made

    def named(self, value: Any) -> str:
        if isinstance(value, str):
            return value
        array = np.array(value, np.int64 if isinstance(value, list) else np.float32)
        self.constants.append(numpy_helper.from_array(array, f"constant{len(self.constants)}"))
        return self.constants[-1].name


def found(g: Graph, x: str) -> dict[str, str]:
    """For (B, 3, H, W) from 0 to 1: corners and centred boxes (B, 3, 4), shares of both, and if
    there is one (B, 3, 1).

    A pixel belongs to a colour that leads by half.
    """
    colours = g("Split", x, axis=1, outputs=3)
    rivals = [g("Max", *(one for one in colours if one != colour)) for colour in colours]
    mask = g(
        "Cast", g("Greater", g("Sub", x, g("Concat", *rivals, axis=1)), 0.5), to=TensorProto.FLOAT
    )
    low = list[str]()
    high = list[str]()
    most = list[str]()
    there = ""
    for other in (2, 3):
        line = g("ReduceMax", mask, axes=[other], keepdims=0)
        there = g("ReduceMax", line, axes=[2])
        place = g("CumSum", g("Add", g("Mul", line, 0.0), 1.0), g("Squeeze", [2]))
        most.append(g("Unsqueeze", g("ReduceMax", place, keepdims=0), [0]))
        high.append(g("ReduceMax", g("Mul", line, place), axes=[2]))
        nearest = g("ReduceMax", g("Mul", line, g("Sub", 1e5, place)), axes=[2])
        low.append(g("Mul", there, g("Sub", 1e5 - 1, nearest)))
    middle = [g("Mul", g("Add", a, b), 0.5) for a, b in zip(low, high, strict=True)]
    size = [g("Sub", b, a) for a, b in zip(low, high, strict=True)]
    corners = g("Concat", *low, *high, axis=2)
    centred = g("Concat", *middle, *size, axis=2)
    again = g("Concat", *middle, *(g("Mul", one, 0.9) for one in size), axis=2)
    whole = g("Concat", *most, *most, axis=0)
    shares = {"corners share": g("Div", corners, whole), "centred share": g("Div", centred, whole)}
    flipped = g("Concat", low[1], low[0], high[1], high[0], axis=2)
    shares["flipped share"] = g("Div", flipped, g("Concat", *most[::-1], *most[::-1], axis=0))
    return {"corners": corners, "centred": centred, "again": again, "there": there, **shares}


def heads(g: Graph, layout: str, x: str, classes: int = 3) -> dict[str, tuple[str, str, int]]:
    """Name, node, type and number of axes of each output; those with a score of each class have so
    many, of which only the first three are ever above 0.
    """
    f = found(g, x)
    score = g("Mul", f["there"], np.array([[[0.9], [0.8], [0.7]]]))
    table = g("Mul", score, np.eye(3, classes)[None])
    kind = g("Add", g("Mul", score, 0.0), np.array([[[0.0], [1.0], [2.0]]]))
    flat = g("Squeeze", score, [2])
    label = g("Cast", g("Squeeze", kind, [2]), to=TensorProto.INT64)
    if layout in ("pose", "masks", "face"):
        return with_more(g, layout, f, table)
    if layout == "rtdetr-rows":
        spare = g("Add", g("Mul", score, 0.0), np.array([[[0.6, 0.4, 0.2, 0.3, 0.01, 0.0]]]))
        rows = g("Concat", f["centred share"], score, kind, axis=2)
        return {"output0": (g("Concat", rows, spare, axis=1), "float", 3)}
    if layout == "yolox":
        return {"output": (relative_to_cells(g, f, table), "float", 3)}
    if layout in ("yolov8", "yolov5"):
        more = [f["there"]] if layout == "yolov5" else []
        first = g("Concat", f["centred"], *more, table, axis=2)
        second = g("Concat", f["again"], *more, g("Mul", table, 0.9), axis=2)
        # A network has more boxes than classes.
        padding = max(PADDING, 3 * classes)
        rows = g("Pad", g("Concat", first, second, axis=1), [0, 0, 0, 0, padding, 0])
        return {"output0": (rows if more else g("Transpose", rows, perm=[0, 2, 1]), "float", 3)}
    if layout == "end2end":
        return {"output0": (g("Concat", f["corners"], score, kind, axis=2), "float", 3)}
    if layout == "queries":
        return {"output0": (g("Concat", f["centred share"], table, axis=2), "float", 3)}
    if layout == "torchvision":
        boxes, scores, labels = (g("Squeeze", one, [0]) for one in (f["corners"], flat, label))
        return {
            "boxes": (boxes, "float", 2),
            "labels": (labels, "int64", 1),
            "scores": (scores, "float", 1),
        }
    if layout == "rtdetr":
        wanted = g("Cast", "orig_target_sizes", to=TensorProto.FLOAT)
        boxes = g(
            "Mul", f["corners share"], g("Unsqueeze", g("Concat", wanted, wanted, axis=1), [1])
        )
        return {
            "labels": (label, "int64", 2),
            "boxes": (boxes, "float", 3),
            "scores": (flat, "float", 2),
        }
    if layout == "detr":
        logits = g("Mul", g("Concat", table, g("Sub", 1.0, f["there"]), axis=2), 10.0)
        return {"logits": (logits, "float", 3), "pred_boxes": (f["centred share"], "float", 3)}
    if layout == "rfdetr":
        logits = g("Sub", g("Mul", table, 10.0), 5.0)
        return {"dets": (f["centred share"], "float", 3), "labels": (logits, "float", 3)}
    count = g("ReduceSum", f["there"], [1, 2], keepdims=0)
    given = {
        "num_detections": (count, "float", 1),
        "detection_boxes": (f["flipped share"], "float", 3),
    }
    return given | {
        "detection_scores": (flat, "float", 2),
        "detection_classes": (g("Squeeze", kind, [2]), "float", 2),
    }


def with_more(
    g: Graph, layout: str, f: dict[str, str], table: str
) -> dict[str, tuple[str, str, int]]:
    """Outputs of a YOLO whose boxes have scores of three classes, and body points, face points or
    masks.
    """
    zero = g("Mul", f["there"], 0.0)
    numbers = np.linspace(3.3, 90.0, 30).reshape(1, 3, 10)
    if layout == "face":
        parts = [f["centred"], f["there"], g("Add", zero, numbers), table]
        rows = g("Concat", *parts, axis=2)
        return {"output": (g("Pad", rows, [0, 0, 0, 0, PADDING, 0]), "float", 3)}
    if layout == "pose":
        visible = np.where(np.arange(6) % 3 == 2, 0.5, numbers[..., :6])
        rows = g("Concat", f["centred"], table, g("Add", zero, visible), axis=2)
    else:
        signed = np.linspace(-1.5, 1.5, 12).reshape(1, 3, 4)
        rows = g("Concat", f["centred"], table, g("Add", zero, signed), axis=2)
    rows = g("Pad", rows, [0, 0, 0, 0, PADDING, 0])
    outputs = {"output0": (g("Transpose", rows, perm=[0, 2, 1]), "float", 3)}
    if layout == "masks":
        masks = g("Add", g("Unsqueeze", zero, [3]), np.zeros((1, 3, 4, 5)))
        outputs["output1"] = (g("Transpose", masks, perm=[0, 2, 1, 3]), "float", 4)
    return outputs


def relative_to_cells(g: Graph, f: dict[str, str], table: str) -> str:
    """Rows of a YOLOX for an input of 128x96 pixels, relative to its 252 cells; the first three are
    those of the blobs.
    """
    middle, size = g("Split", f["centred"], axis=2, outputs=2)
    offset = g("Sub", g("Mul", middle, 1 / 8), np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]))
    logarithm = g("Log", g("Mul", g("Max", size, 1e-3), 1 / 8))
    rows = g("Concat", offset, logarithm, f["there"], table, axis=2)
    return str(g("Pad", rows, [0, 0, 0, 0, 252 - 3, 0]))


def answering(
    path: Path,
    outputs: Mapping[str, np.ndarray],
    metadata: Mapping[str, str] | None = None,
    side: int = 64,
    pairs: tuple[str, ...] = (),
) -> Path:
    """A network that takes (1, 3, side, side), and pairs of numbers by these names, and has these
    outputs for every picture.
    """
    kinds = {"f": TensorProto.FLOAT, "i": TensorProto.INT64}
    nodes = [helper.make_node("Identity", [f"{name}.value"], [name]) for name in outputs]
    values = list[onnx.TensorProto]()
    made = list[onnx.ValueInfoProto]()
    for name, array in outputs.items():
        kept = array.astype(np.float32 if array.dtype.kind == "f" else np.int64)
        values.append(numpy_helper.from_array(kept, f"{name}.value"))
        made.append(helper.make_tensor_value_info(name, kinds[kept.dtype.kind], array.shape))
    taken = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, side, side))
    more = [helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 2)) for name in pairs]
    graph = helper.make_graph(nodes, "answers", [taken, *more], made, values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    path.write_bytes(model.SerializeToString())
    return path


def write(
    path: Path,
    layout: str = "yolov8",
    shape: tuple[object, ...] = ("N", 3, 96, 128),
    kind: str = "float",
    metadata: Mapping[str, str] | None = None,
    outputs: str = "",
    classes: int = 3,
) -> Path:
    """A network file; ``outputs`` is the type of the outputs, where it is not float, ``classes``
    how many a network with scores of all classes has.
    """
    g = Graph()
    x = "images"
    x = g("Cast", x, to=TensorProto.FLOAT) if kind != "float" else x
    x = g("Mul", x, 1 / 255) if kind == "uint8" else x
    x = g("Unsqueeze", x, [0]) if len(shape) == 3 else x
    x = g("Transpose", x, perm=[0, 3, 1, 2]) if shape[-1] == 3 else x
    if layout in ("detr", "rfdetr"):
        deviation = np.array([0.229, 0.224, 0.225])
        mean = np.array([0.485, 0.456, 0.406])
        x = g("Add", g("Mul", x, deviation[None, :, None, None]), mean[None, :, None, None])
    if layout == "yolox":
        x = g("Gather", g("Mul", x, 1 / 255), [2, 1, 0], axis=1)
    made = []
    given = [helper.make_tensor_value_info("images", TYPES[kind], shape)]
    for name, (node, what, axes) in heads(g, layout, x, classes).items():
        what = outputs if outputs and what == "float" else what
        g.nodes.append(helper.make_node("Cast", [node], [name], to=TYPES[what]))
        made.append(
            helper.make_tensor_value_info(name, TYPES[what], [f"{name}{k}" for k in range(axes)])
        )
    if layout == "rtdetr":
        given.append(
            helper.make_tensor_value_info("orig_target_sizes", TYPES["int64"], [shape[0], 2])
        )
    graph = helper.make_graph(g.nodes, "blobs", given, made, g.constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.checker.check_model(model, full_check=True)
    path.write_bytes(model.SerializeToString())
    return path


def scene(
    width: int, height: int, boxes: Mapping[int, tuple[int, int, int, int]], number: int = 1
) -> Frame:
    """Grey, with a blob of each class (0 red, 1 green, 2 blue) in its box."""
    image = np.full((height, width, 3), 90, np.uint8)
    for code, (left, top, right, bottom) in boxes.items():
        colour = tuple(255 if channel == 2 - code else 0 for channel in range(3))
        cv2.rectangle(image, (left, top), (right - 1, bottom - 1), colour, -1)
    return Frame(number, number / 25, image)


def truth(boxes: Mapping[int, tuple[int, int, int, int]]) -> F8:
    """(N, 4) the boxes by class."""
    return np.array([boxes[code] for code in sorted(boxes)], np.float64).reshape(-1, 4)


def write_embeddings(
    path: Path,
    shape: tuple[object, ...] = CROPS,
    kind: str = "float",
    metadata: Mapping[str, str] | None = None,
    layer: Callable[[Graph, str], Any] | None = None,
) -> Path:
    """A network whose vector is the mean of each channel, and of its square."""
    g = Graph()
    x = g("Cast", "crops", to=TensorProto.FLOAT)
    if shape[1] != 3:
        x = g("Transpose", x, perm=[0, 3, 1, 2])
    mean = g("ReduceMean", x, axes=[2, 3], keepdims=1)
    square = g("ReduceMean", g("Mul", x, x), axes=[2, 3], keepdims=1)
    out = g("Concat", mean, square, axis=1)
    if layer is not None:
        out = layer(g, out)
    given = helper.make_tensor_value_info("crops", TYPES[kind], list(shape))
    result = helper.make_tensor_value_info("vectors", TensorProto.FLOAT, None)
    g.nodes.append(helper.make_node("Identity", [out], ["vectors"]))
    graph = helper.make_graph(g.nodes, "looks", [given], [result], g.constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    for name, value in (metadata or {}).items():
        entry = model.metadata_props.add()
        entry.key = name
        entry.value = value
    onnx.save(model, path)
    return path
