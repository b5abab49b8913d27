"""Records to plain dictionaries and back, for checkpoints. Only the records listed here can be read: no code is loaded."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from phdtrack.associate.graph import GraphState
from phdtrack.associate.history import Chunk, History, Moment
from phdtrack.associate.labels import LabelledState, Lives
from phdtrack.associate.online import Carried, Given
from phdtrack.associate.rejection import RejectionState
from phdtrack.associate.window import Columns, Edges, Links, Rows, Window
from phdtrack.detect.merged import ExpectedTargets
from phdtrack.errors import InputError
from phdtrack.filters.bernoullis import Bernoullis, Layer
from phdtrack.filters.hypotheses import Cluster, Hypotheses, Nodes
from phdtrack.filters.intensities import Cardinalised, JointSamples
from phdtrack.models.followed_rates import RatesState
from phdtrack.models.followed_scene import SceneState
from phdtrack.models.learned_scene import ContextBirth, ContextClutter
from phdtrack.pipeline import TrackingState
from phdtrack.scene import ContextDensity
from phdtrack.scene.evidence import Evidence
from phdtrack.scene.modes import Mode
from phdtrack.scene.online import Knowledge, Relearned
from phdtrack.scene.part import Part
from phdtrack.scene.rates import Counted, Judged, Known, Learned, Moments, Noise, Rates, Scale, Successive
from phdtrack.scene.recent import Recent
from phdtrack.scene.sightings import Sightings
from phdtrack.scene.verdict import Look, Watch
from phdtrack.types import Estimates, GaussianMixture, ParticleBlocks, Particles, Tracks

_RECORDS: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (
        TrackingState,
        Particles,
        ParticleBlocks,
        GaussianMixture,
        Cardinalised,
        JointSamples,
        Hypotheses,
        Nodes,
        Cluster,
        Estimates,
        Bernoullis,
        Layer,
        ExpectedTargets,
        GraphState,
        LabelledState,
        RejectionState,
        Lives,
        History,
        Chunk,
        Moment,
        Given,
        Carried,
        Window,
        Columns,
        Rows,
        Edges,
        Links,
        Tracks,
        SceneState,
        RatesState,
        Learned,
        Known,
        Counted,
        Judged,
        Rates,
        Scale,
        Successive,
        Moments,
        Noise,
        Knowledge,
        Relearned,
        Mode,
        Part,
        Recent,
        Evidence,
        Watch,
        Look,
        Sightings,
        ContextDensity,
        ContextBirth,
        ContextClutter,
    )
}


def pack(value: Any) -> Any:
    """Dictionaries, lists, numbers and arrays that `unpack` makes the same value of. Arrays are copied."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, tuple):
        return [pack(item) for item in value]
    if isinstance(value, dict):
        return {"record": "dict", "keys": list(value), "values": [pack(item) for item in value.values()]}
    if type(value).__name__ in _RECORDS:
        inside = {field.name: pack(getattr(value, field.name)) for field in fields(value)}
        return {"record": type(value).__name__, "fields": inside}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InputError(f"a state of type {type(value).__name__} cannot be saved", where="state_dict")


def unpack(value: Any) -> Any:
    """The value that `pack` was given.

    Raises
    ------
    InputError : a record that this version does not know.
    """
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, list):
        return tuple(unpack(item) for item in value)
    if isinstance(value, dict):
        name = value["record"]
        if name == "dict":
            return dict(zip(value["keys"], (unpack(item) for item in value["values"]), strict=True))
        if name not in _RECORDS:
            raise InputError(f"the saved state holds a record {name!r}, which this version does not know")
        return _RECORDS[name](**{key: unpack(item) for key, item in value["fields"].items()})
    return value
