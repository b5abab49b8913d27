"""Labels of detections by people: false alarms, missed objects, and where objects enter."""

from phdtrack.label.store import DRAWN, Label, LabelStore, Mark, Progress

__all__ = ["DRAWN", "Label", "LabelStore", "Mark", "Progress"]
