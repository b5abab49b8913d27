"""Corrected tracks when everything is known: pieces of one target joined, and all rows smoothed."""
