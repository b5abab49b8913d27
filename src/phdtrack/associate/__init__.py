"""From states to identities, online and corrected offline: multi-frame graph matching, or the filter's own labels."""

from phdtrack.associate.graph import GraphMatching, GraphState
from phdtrack.associate.labelled import Labelled, LabelledState

__all__ = ["GraphMatching", "GraphState", "Labelled", "LabelledState"]
