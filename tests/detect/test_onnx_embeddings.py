"""Networks that describe boxes: what their inputs get, batches, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import networks
from phdtrack.detect.base import Describer
from phdtrack.detect.embedding_settings import EmbeddingSettings
from phdtrack.detect.onnx_embeddings import EmbeddingNetwork
from phdtrack.errors import InputError
from phdtrack.types import F4, F8, Image

BOXES = np.array([[0, 0, 20, 40], [20, 0, 40, 40], [-9, -9, -1, -1], [30, 0, 60, 40]], np.float64)
USUAL = networks.CROPS


def picture() -> Image:
    """Red beside blue (BGR)."""
    image = np.zeros((40, 50, 3), np.uint8)
    image[:, :20] = (10, 20, 200)
    image[:, 20:] = (220, 40, 30)
    return image


def expected(mean: F8, deviation: F8, colour: tuple[int, int, int]) -> F8:
    """The unit vector of one colour (RGB)."""
    value = (np.array(colour) / 255 - mean) / deviation
    vector = np.concatenate([value, value**2])
    return np.asarray(vector / np.linalg.norm(vector))


IMAGENET = (np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225]))


def unit(vectors: F4) -> None:
    """Assert what holds for all networks of `BOXES`."""
    np.testing.assert_array_equal(vectors, vectors.astype(np.float16))
    assert not vectors[2].any()
    np.testing.assert_allclose(np.linalg.norm(vectors[[0, 1, 3]], axis=1), 1, atol=2e-3)
    np.testing.assert_allclose(vectors[3], vectors[1], atol=2e-3)


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        (USUAL, "float"),
        ((1, 3, 64, 32), "float"),
        ((8, 3, 64, 32), "float"),
        (("N", 64, 32, 3), "float"),
        (("N", 3, "H", "W"), "float"),
        (USUAL, "float16"),
    ],
)
def test_crops_are_normalised_by_imagenet(
    tmp_path: Path, shape: tuple[object, ...], kind: str
) -> None:
    network: Describer = EmbeddingNetwork(
        networks.write_embeddings(tmp_path / "net.onnx", shape, kind)
    )
    assert network.length == 6
    vectors = network.describe(picture(), BOXES)
    unit(vectors)
    np.testing.assert_allclose(vectors[0], expected(*IMAGENET, (200, 20, 10)), atol=3e-3)
    np.testing.assert_allclose(vectors[1], expected(*IMAGENET, (30, 40, 220)), atol=3e-3)
    assert network.describe(picture(), np.zeros((0, 4))).shape == (0, 6)


def test_settings_and_metadata_change_the_input(tmp_path: Path) -> None:
    half = (np.full(3, 0.5), np.full(3, 0.25))
    settings = EmbeddingSettings(mean=(0.5, 0.5, 0.5), deviation=(0.25, 0.25, 0.25))
    plain = networks.write_embeddings(tmp_path / "net.onnx")
    stated = networks.write_embeddings(
        tmp_path / "told.onnx", metadata={"mean": "[0.5]*3", "std": "nonsense"}
    )
    known = networks.write_embeddings(
        tmp_path / "known.onnx", metadata={"mean": "[0.5, 0.5, 0.5]", "std": "(0.25, 0.25, 0.25)"}
    )
    for file, given in ((plain, settings), (known, None)):
        network = EmbeddingNetwork(file, given)
        assert network.guesses == ()
        vectors = network.describe(picture(), BOXES)
        np.testing.assert_allclose(vectors[0], expected(*half, (200, 20, 10)), atol=3e-3)
    vectors = EmbeddingNetwork(stated).describe(picture(), BOXES)
    np.testing.assert_allclose(vectors[0], expected(*IMAGENET, (200, 20, 10)), atol=3e-3)
    vectors = EmbeddingNetwork(plain, EmbeddingSettings(bgr=True)).describe(picture(), BOXES)
    reversed_imagenet = (IMAGENET[0][::-1], IMAGENET[1][::-1])
    np.testing.assert_allclose(vectors[0], expected(*reversed_imagenet, (10, 20, 200)), atol=3e-3)


def test_bytes_go_in_as_they_are(tmp_path: Path) -> None:
    network = EmbeddingNetwork(networks.write_embeddings(tmp_path / "net.onnx", USUAL, "uint8"))
    assert network.guesses == ()
    vectors = network.describe(picture(), BOXES)
    unit(vectors)
    vector = np.array([200, 20, 10, 200**2, 20**2, 10**2], np.float64)
    np.testing.assert_allclose(vectors[0], vector / np.linalg.norm(vector), atol=1e-3)


def test_the_guess_is_told_with_its_cure(tmp_path: Path) -> None:
    (sentence,) = EmbeddingNetwork(networks.write_embeddings(tmp_path / "net.onnx")).guesses
    assert "crops go in as 32x64 pixels, red first, with mean and deviation of ImageNet" in sentence
    assert "embedding.mean" in sentence
    network = EmbeddingNetwork(networks.write_embeddings(tmp_path / "any.onnx", ("N", 3, "H", "W")))
    assert "128x256 pixels" in network.guesses[0]


def test_batches_give_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (90, 90, 3)).astype(np.uint8)
    corner = rng.uniform(0, 60, (23, 2))
    boxes = np.hstack([corner, corner + 25])
    file = networks.write_embeddings(tmp_path / "net.onnx")
    whole = EmbeddingNetwork(file).describe(image, boxes)
    for batch in (1, 5):
        found = EmbeddingNetwork(file, EmbeddingSettings(batch=batch)).describe(image, boxes)
        np.testing.assert_allclose(found, whole, atol=2e-3)


def first_channel(g: networks.Graph, x: str) -> str:
    return str(g("ReduceMean", x, axes=[1], keepdims=1))


def one_for_all(g: networks.Graph, x: str) -> str:
    return str(g("ReduceMean", x, axes=[0], keepdims=1))


def test_other_outputs_and_inputs_are_refused(tmp_path: Path) -> None:
    cases = (
        (
            networks.write_embeddings(tmp_path / "a.onnx", layer=first_channel),
            "got an output (1, 1, 1, 1)",
        ),
        (
            networks.write_embeddings(tmp_path / "b.onnx", ("N", 4, 64, 32)),
            "the network's inputs are not supported",
        ),
    )
    for file, message in cases:
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            EmbeddingNetwork(file)
        assert "give one vector for each, (N, length)" in str(caught.value)
    network = EmbeddingNetwork(networks.write_embeddings(tmp_path / "c.onnx", layer=one_for_all))
    with pytest.raises(InputError, match="expected one vector for each of 3 crops"):
        network.describe(picture(), BOXES)
    with pytest.raises(InputError, match="the network only takes crops of 32x64 pixels"):
        EmbeddingNetwork(
            networks.write_embeddings(tmp_path / "d.onnx"), EmbeddingSettings(size=(64, 128))
        )
    with pytest.raises(InputError, match="Export them to ONNX once"):
        EmbeddingNetwork(tmp_path / "weights.pt")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mean": (0.5,)}, "embedding.mean: expected three numbers"),
        ({"deviation": (1.0, 0.0, 1.0)}, "embedding.deviation: expected deviations above 0"),
        ({"size": (-1, 5)}, "embedding.size: expected a width and height in pixels"),
        ({"batch": 0}, "batch: expected a value at least 1"),
    ],
)
def test_settings_out_of_bounds_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        EmbeddingSettings(**values)  # type: ignore[arg-type]
