"""What people say about detections: which are false, where objects enter."""

from phdtrack.label.store import Label, LabelStore, Mark, Progress

__all__ = ["Label", "LabelStore", "Mark", "Progress"]
