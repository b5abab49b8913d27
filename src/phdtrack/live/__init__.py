"""Cameras that never end: their sources, zones and lines, events, and where all of it goes."""
