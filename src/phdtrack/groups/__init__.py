"""Groups of people: who walks with whom, how many they are, where, and what becomes of them [E13 §4.3].

intensity ─cluster→ Groups ─contours→ polygons
                      └─identity→ groups with a life: appear, vanish, merge, split ─warnings→ who is about to meet
"""

from phdtrack.groups.clusters import Contours, Grouping, Groups, polygon_area
from phdtrack.groups.life_cycle import Event, Living, Meetings, Observed, Warned

__all__ = ["Contours", "Event", "Grouping", "Groups", "Living", "Meetings", "Observed", "Warned", "polygon_area"]
