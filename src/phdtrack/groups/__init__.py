"""Groups of people: who walks with whom, how many they are, where, and what becomes of them [E13 §4.3].

intensity ─cluster→ Groups ─contours→ polygons
                      └─identity→ groups with a life: appear, vanish, merge, split ─warnings→ who is about to meet
"""

from phdtrack.groups.cluster import Grouping, Groups
from phdtrack.groups.contour import Contours, polygon_area
from phdtrack.groups.identity import Event, Living, Observed
from phdtrack.groups.warnings import Meetings, Warned

__all__ = ["Contours", "Event", "Grouping", "Groups", "Living", "Meetings", "Observed", "Warned", "polygon_area"]
