"""Groups of people: members, number, place, and how they change [E13 §5].

intensity ─cluster→ Groups ─contours→ polygons
                      └─life cycle→ identities and events ─encounters→ warnings
"""

from phdtrack.groups.clusters import Contours, Grouping, Groups, polygon_area
from phdtrack.groups.life_cycle import Encounter, EncounterWarning, Event, GroupLifeCycle, LifeCycleState

__all__ = [
    "Contours",
    "Encounter",
    "EncounterWarning",
    "Event",
    "GroupLifeCycle",
    "Grouping",
    "Groups",
    "LifeCycleState",
    "polygon_area",
]
