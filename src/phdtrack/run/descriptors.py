"""Sources of embeddings, as a user names them: the pictures, or a file beside the detections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.detect.base import Describer
from phdtrack.detect.colours import Colours
from phdtrack.detect.embedding_settings import EmbeddingSettings
from phdtrack.detect.table_detector import TableDetector
from phdtrack.errors import InputError, did_you_mean
from phdtrack.formats.embeddings import open_embeddings
from phdtrack.run.directory import DETECTIONS, EMBEDDINGS
from phdtrack.run.inputs import Descriptors, Inputs
from phdtrack.run.requests import DEFAULT_APPEARANCE

_OPTION = "--appearance"
_NETWORK = "onnx:"
_NAMES = ("colours", "none", "onnx:FILE", "FILE.npy")
# Other spellings of names.
_SAME = {"colors": "colours", "color": "colours", "colour": "colours"}


class PictureDescriber(NamedTuple):
    """A describer with its name, and sentences about what it had to guess."""

    describer: Describer | None = None
    name: str = ""
    guesses: tuple[str, ...] = ()


def picture_describer(appearance: str, settings: Mapping[str, Any]) -> PictureDescriber:
    """The describer that a word names; none for ``none``, and for a file.

    Raises `InputError` for an unknown word, and for a network that cannot be used.

    Parameters
    ----------
    appearance : as `TrackingRequest.appearance`, not empty.
    settings : of a network, by name.
    """
    checked = EmbeddingSettings.of(settings)
    word = _SAME.get(appearance, appearance)
    if word == "colours":
        return PictureDescriber(Colours(), word)
    if word.startswith(_NETWORK):
        # Networks need OpenCV and onnxruntime.
        from phdtrack.detect.onnx_embeddings import EmbeddingNetwork

        network = EmbeddingNetwork(word.removeprefix(_NETWORK), checked)
        return PictureDescriber(network, word, network.guesses)
    if word == "none" or is_file(word):
        return PictureDescriber()
    cure = did_you_mean(word, _NAMES)
    if word.endswith(".onnx"):
        cure = f"Say {_NETWORK}{word}"
    raise InputError(f"there is no appearance {word!r}", where=_OPTION, cure=cure)


def is_file(appearance: str) -> bool:
    """True if the word is the name of a file of embeddings."""
    return appearance.endswith((".npy", ".npz"))


def with_descriptors(inputs: Inputs, appearance: str, settings: Mapping[str, Any]) -> Inputs:
    """The inputs with a source of embeddings.

    A file that a run has kept beside its detections is used unless the user says otherwise, which
    is told; it is not if it has another number of rows.

    Parameters
    ----------
    inputs : frames and detector.
    appearance : as `TrackingRequest.appearance`.
    settings : of a network, by name.

    Raises
    ------
    InputError : an unknown word, a source that does not go with the inputs, or a file or network
        that cannot be used.
    """
    if not appearance:
        kept = _kept_beside(inputs)
        if kept is not None:
            return kept
        appearance = DEFAULT_APPEARANCE if inputs.pictures else "none"
    if is_file(appearance):
        return _with_file(inputs, Path(appearance))
    chosen = picture_describer(appearance, settings)
    if chosen.describer is None:
        return inputs
    if not inputs.pictures:
        raise InputError(
            "it is read from pictures, and there are none",
            where=f"{_OPTION} {chosen.name}",
            cure="Name the video beside the detections, or give a .npy file.",
        )
    return replace(
        inputs,
        descriptors=Descriptors(chosen.name, chosen.describer),
        warnings=(*inputs.warnings, *chosen.guesses),
        files=(*inputs.files, chosen.name.partition(":")[2]),
    )


def _kept_beside(inputs: Inputs) -> Inputs | None:
    """The inputs with the file that a run has written beside the detections; None without one."""
    detections = Path(inputs.described)
    file = detections.with_name(EMBEDDINGS)
    if not isinstance(inputs.detector, TableDetector) or detections.name != DETECTIONS:
        return None
    if not file.exists():
        return None
    try:
        found = _with_file(inputs, file)
        note = f"{file}: what the detections look like is read from it ({_OPTION} none: it is not)"
    except InputError as error:
        found = inputs
        note = f"{error} It is not used."
    return replace(found, warnings=(*inputs.warnings, note))


def _with_file(inputs: Inputs, file: Path) -> Inputs:
    """The inputs with the embeddings in a file. Raises `InputError` if it cannot be used."""
    detector = inputs.detector
    if not isinstance(detector, TableDetector):
        raise InputError(
            "a .npy file has a row for each row of a file of detections, and there is none",
            where=f"{_OPTION} {file}",
            cure="Say --detections FILE, too.",
        )
    embeddings = open_embeddings(file, detector.table.rows, inputs.described)
    kept = "float16" if embeddings.dtype == np.float16 else "float32"
    return replace(
        inputs,
        detector=replace(detector, embeddings=embeddings),
        descriptors=Descriptors(str(file), dtype=kept),
        files=(*inputs.files, file),
    )
