"""Corrected tracks: stitched and smoothed with all measurements, past and future."""
