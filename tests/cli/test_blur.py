"""``--blur``: of every picture that a command writes or serves, what is inside boxes is a few cells
of one colour each.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from phdtrack.arrays import pixelated
from phdtrack.cli.app import application
from phdtrack.cli.output import Output
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.label import Label, LabelStore
from phdtrack.label.sequences import hidden_picture, open_sequence, still_pictures
from phdtrack.run.requests import SourceRequest
from phdtrack.types import Image
from phdtrack.video import VideoWriter, open_source

# Maps of reports are pictures too.
pytestmark = pytest.mark.usefixtures("drawn")

WIDE = 320
HIGH = 240
SIDE = 64
FRAMES = 30


def chequered(side: int) -> Image:
    """Squares of two pixels, black and white: coding keeps them, blurring does not."""
    block = np.kron([[0, 255], [255, 0]], np.ones((2, 2))).astype(np.uint8)
    return np.repeat(np.tile(block, (side // 4, side // 4))[..., None], 3, axis=2)


def where(number: int) -> np.ndarray:
    left = 20.0 + 6 * number
    return np.array([left, 90, left + SIDE, 90 + SIDE])


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chequered square that goes to the right on grey, its detections, missing in some frames,
    and truth.
    """
    folder = tmp_path_factory.mktemp("scene")
    with VideoWriter(folder / "walk.mp4", WIDE, HIGH, 25.0) as video:
        for number in range(1, FRAMES + 1):
            image = np.full((HIGH, WIDE, 3), 120, np.uint8)
            left, top, right, bottom = where(number).astype(int)
            image[top:bottom, left:right] = chequered(SIDE)
            video.write(image)
    lines = [
        f"{k},-1,{where(k)[0]},{where(k)[1]},{SIDE},{SIDE},0.9"
        for k in range(1, FRAMES + 1)
        if not 12 < k < 20
    ]
    lines += [f"{k},-1,250,10,30,40,0.9" for k in range(3, 13)]
    (folder / "det.txt").write_text("\n".join(lines) + "\n")
    (folder / "gt.txt").write_text(
        "".join(
            f"{k},1,{where(k)[0]},{where(k)[1]},{SIDE},{SIDE},1,1,1\n" for k in range(1, FRAMES + 1)
        )
    )
    (folder / "camera.txt").write_text("0.02 0 0\n0 0.02 0\n0 0 1\n")
    # What stays where the square begins, marked as false, is something to be learned.
    left, top, *_ = where(1)
    (folder / "still.txt").write_text(
        "".join(f"{k},-1,{left},{top},{SIDE},{SIDE},0.9\n" for k in range(1, FRAMES + 1))
    )
    digest = open_sequence(
        SourceRequest(str(folder / "walk.mp4"), folder / "still.txt"), {}, folder / "x", Output()
    ).digest
    store = LabelStore.open(folder / "walk.labels.sqlite", "walk", digest, range(1, FRAMES + 1))
    for k in range(1, FRAMES + 1):
        store.mark(k, [Label(k, 0, "false")])
        store.finish(k)
    return folder


def run(*words: str | Path) -> None:
    result = CliRunner().invoke(application(str(words[0])), [str(word) for word in words])
    assert result.exit_code == 0, (words, result.output, result.exception)


def pictures(folder: Path) -> Iterator[tuple[str, Image]]:
    """Every picture in a folder, and in the pages in it."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        data = path.read_bytes()
        if path.suffix == ".mp4":
            for frame in open_source(path):
                yield f"{path.name} {frame.number}", frame.image
        found = (
            re.findall(rb"data:image/(?:jpeg|png);base64,([A-Za-z0-9+/=]+)", data)
            if path.suffix == ".html"
            else ()
        )
        for k, one in enumerate(
            [*map(base64.b64decode, found), *([data] if path.suffix in (".png", ".jpg") else [])]
        ):
            image = cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            yield f"{path.name}, picture {k}", image
        # Charts hold no picture.
        assert path.suffix != ".html" or b"<image" not in data


def roughest(image: Image, name: str = "") -> float:
    """The share of the picture that is chequered finely. Pages darken and enlarge it."""
    grey = image.mean(axis=2).astype(np.float32)
    deviation = np.sqrt(np.maximum(cv2.blur(grey * grey, (8, 8)) - cv2.blur(grey, (8, 8)) ** 2, 0))
    strong = cv2.erode(
        (deviation > (33 if ".html" in name else 60)).astype(np.uint8), np.ones((12, 12), np.uint8)
    )
    return float(strong.mean())


WRITTEN = {
    "track": {"annotated.mp4", "report.html"},
    "groups": {"annotated.mp4", "plan.mp4", "report.html"},
    "learn": {"scene.html"},
}
COMMANDS = {
    "track": ("track", "walk.mp4", "--detections", "det.txt"),
    "groups": ("groups", "walk.mp4", "--detections", "det.txt", "--camera", "camera.txt"),
    "learn": (
        "learn",
        "walk.mp4",
        "--detections",
        "still.txt",
        "--labels",
        "walk.labels.sqlite",
    ),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_picture_shows_what_is_in_boxes(
    scene: Path, tmp_path: Path, monkeypatch, command: str
) -> None:
    monkeypatch.chdir(scene)
    target = tmp_path / "scene.json" if command == "learn" else tmp_path
    run(*COMMANDS[command], "--out", target, "--overwrite", "--blur", "boxes")
    found = [(name, image, roughest(image, name)) for name, image in pictures(tmp_path)]
    assert {name.split()[0].strip(",") for name, _, _ in found} >= WRITTEN[command]
    # What is written without it is seen by this test.
    assert roughest(next(iter(open_source(scene / "walk.mp4"))).image) > 0.01
    assert [(name, share) for name, _, share in found if share > 0.003] == []
    if command == "track":
        run(*COMMANDS[command], "--out", tmp_path, "--overwrite")
        plain = {
            name.split()[0].strip(",")
            for name, image in pictures(tmp_path)
            if roughest(image, name) > 0.01
        }
        assert plain == WRITTEN[command]
        assert "are hidden" not in (tmp_path / "report.html").read_text()


def test_pictures_of_the_labelling_page_can_be_blurred(scene: Path) -> None:
    table = read_detections(scene / "det.txt")
    for blur in ("", "boxes"):
        stills = still_pictures(
            SourceRequest(str(scene / "walk.mp4")),
            [3],
            {2, 3, 4},
            partial(hidden_picture, table, blur),
        )
        assert sorted(stills) == [2, 3, 4]
        for data in stills.values():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            assert (roughest(np.asarray(image, np.uint8)) > 0.01) == (blur == "")


@pytest.mark.parametrize("blur", ["boxes", "faces"])
def test_inside_a_box_are_means_of_cells_only(blur: str) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (HIGH, WIDE, 3), np.uint8)
    # Of all sizes, at the edges, beyond them, huge, inverted and not finite.
    boxes = np.array(
        [
            [40, 30, 100, 210],
            [150, 100, 153, 104],
            [-20, -30, 25, 40],
            [300, 200, 400, 400],
            [200, 50, 190, 40],
        ]
    )
    boxes = np.vstack([boxes, [[np.nan, 0, 10, 10], [1e300, 0, 2e300, 5]]])
    out = pixelated(image, boxes, blur)
    changed = np.zeros((HIGH, WIDE), bool)
    for left, top, right, bottom in boxes[:4].astype(int):
        if blur == "faces":
            bottom = top + (bottom - top) // 3
        inside = out[max(0, top) : max(0, bottom), max(0, left) : right]
        changed[max(0, top - 20) : max(0, bottom + 20), max(0, left - 20) : right + 20] = True
        # At most eight cells across, none below eight pixels: few colours.
        assert len(np.unique(inside.reshape(-1, 3), axis=0)) <= min(
            64, (inside.shape[0] // 8 + 2) * (inside.shape[1] // 8 + 2)
        )
    assert (out == image)[~changed].all()
    assert not (out == image).all()
    assert pixelated(image, boxes, "") is image
    with pytest.raises(InputError, match="boxes or faces"):
        pixelated(image, boxes, "hands")
