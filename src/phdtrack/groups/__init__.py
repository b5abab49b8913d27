"""Groups of people: members, number, place, and how they change [E13 §5].

intensity ─cluster→ Groups ─contours→ polygons
                      └─life cycle→ identities and events ─encounters→ warnings
"""
