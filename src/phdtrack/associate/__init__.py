"""From states to identities, online and corrected offline: multi-frame graph matching, or the filter's own labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.associate.graph import GraphMatching, GraphState
    from phdtrack.associate.labels import Labelled, LabelledState

__getattr__, __dir__ = lazy(
    __name__,
    {
        "GraphMatching": "phdtrack.associate.graph",
        "GraphState": "phdtrack.associate.graph",
        "Labelled": "phdtrack.associate.labels",
        "LabelledState": "phdtrack.associate.labels",
    },
)

__all__ = ["GraphMatching", "GraphState", "Labelled", "LabelledState"]
