"""From states to identities: multi-frame graph matching, online and corrected offline."""

from phdtrack.associate.graph import GraphMatching, GraphState

__all__ = ["GraphMatching", "GraphState"]
