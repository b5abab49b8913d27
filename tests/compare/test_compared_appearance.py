"""Appearance in comparisons: every method gets the same, and as `phdtrack track` has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_cases import FRAMES, planned, sequence

from phdtrack.compare import Plan, run, steps
from phdtrack.compare.runs import ComparedRun, run_input
from phdtrack.detect.colours import Colours
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks
from phdtrack.run import OutputRequest, RunRequest, SourceRequest, TrackingRequest, claim, prepare
from phdtrack.video import VideoWriter, open_source


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence with a video of its two people, in red and in blue."""
    folder = sequence(tmp_path_factory.mktemp("scenes") / "street")
    rng = np.random.default_rng(1)
    ground = rng.integers(110, 130, (240, 320, 3))
    with VideoWriter(folder / "street.mp4", 320, 240, 25.0) as writer:
        for k in range(1, FRAMES + 1):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            for x, y, colour in (
                (20 + 5 * k, 60, (30, 30, 190)),
                (270 - 5 * k, 150, (190, 70, 30)),
            ):
                image[y : y + 60, x : x + 24] = colour
            writer.write(image)
    return folder


def colours_of(scene: Path, made: Plan, out: Path) -> None:
    """Assert that the first run of a plan has the colours of its boxes."""
    inputs = run_input(made.runs[0], out)
    images = {frame.number: frame.image for frame in open_source(scene / "street.mp4")}
    assert len(inputs.frames) == FRAMES
    for one in inputs.frames:
        found = one.detections
        expected = Colours().describe(images[one.frame.number], found.xyxy)
        assert found.embeddings is not None
        np.testing.assert_allclose(found.embeddings, expected, atol=2e-2)


def test_given_detections_are_those_of_track(scene: Path, tmp_path: Path) -> None:
    made = planned([scene], filters=["pmb"], seeds=1, appearance="colours")
    assert steps(made) == 2
    found = run(made, tmp_path / "out")
    assert (found.failed, found.reused) == ([], 0)
    colours_of(scene, made, tmp_path / "out")
    request = RunRequest(
        SourceRequest(str(scene / "street.mp4"), detections=scene / "det" / "det.txt"),
        TrackingRequest(appearance="colours", seed=1),
        OutputRequest(tmp_path / "track"),
        video=False,
    )
    prepare(request).run(claim(tmp_path / "track", False))
    expected = read_tracks(tmp_path / "track" / "tracks.csv")
    tracks = read_tracks(tmp_path / "out" / made.runs[0].place / "tracks.csv")
    np.testing.assert_array_equal(tracks.identity, expected.identity)
    np.testing.assert_array_equal(tracks.xyxy, expected.xyxy)
    assert run(made, tmp_path / "out").reused == 1
    plain = run(planned([scene], filters=["pmb"], seeds=1, appearance="none"), tmp_path / "out")
    assert plain.outdated == ["detections"]
    frames = run_input(plain.plan.runs[0], tmp_path / "out").frames
    assert all(one.detections.embeddings is None for one in frames)


def test_detected_boxes_and_clutter_have_colours(scene: Path, tmp_path: Path) -> None:
    more = {"detectors": ["mog2"], "filters": ["gm-phd"], "seeds": 1, "clutter": [0.0, 2.0]}
    made = planned([scene], appearance="colours", **more)
    found = run(made, tmp_path / "out")
    assert found.failed == []
    colours_of(scene, made, tmp_path / "out")
    more_boxes = run_input(made.runs[1], tmp_path / "out")
    for one in more_boxes.frames:
        assert one.detections.embeddings is not None
        assert len(one.detections.embeddings) == len(one.detections)
    assert all(isinstance(result, ComparedRun) for _, result in found.runs)


def test_appearance_needs_pictures(scene: Path, tmp_path: Path) -> None:
    alone = sequence(tmp_path / "alone")
    with pytest.raises(InputError, match="a comparison reads it from pictures"):
        planned([alone], appearance="colours")
    with pytest.raises(InputError, match="Say colours or onnx:FILE"):
        planned([scene], appearance="looks.npy")
    with pytest.raises(InputError, match="there is no appearance 'hues'"):
        planned([scene], appearance="hues")
    with pytest.raises(InputError, match="there is no such file"):
        planned([scene], appearance="onnx:net.onnx")
    assert planned([alone], appearance="none").cases[0].appearance == ""
    assert planned([alone]).cases[0].appearance == ""
