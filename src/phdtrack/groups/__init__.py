"""Groups of people: members, number, position, and their changes [E13 §5].

intensity ─cluster→ Groups ─contours→ polygons
                      └─life cycle→ identities and events ─encounters→ warnings
"""
