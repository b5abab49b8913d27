"""From states to identities, online and corrected offline: multi-frame graph matching, or the filter's own labels."""

from phdtrack.associate.graph import GraphMatching, GraphState
from phdtrack.associate.labels import Labelled, LabelledState

__all__ = ["GraphMatching", "GraphState", "Labelled", "LabelledState"]
