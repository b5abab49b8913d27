"""Painting: the parts of a rendered scene. Needs OpenCV; imported by the renderer only."""
