"""What people say about detections: which are false, what was missed, where objects enter."""

from phdtrack.label.store import DRAWN, Label, LabelStore, Mark, Progress

__all__ = ["DRAWN", "Label", "LabelStore", "Mark", "Progress"]
