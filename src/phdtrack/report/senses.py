"""Which way each score is better, by its name: the one place that says so, for tables, captions and reports."""

from __future__ import annotations

LOWER = frozenset(
    (
        *("OSPA", "GOSPA", "OSPA2", "id_switches", "misses", "false_positives", "fragments", "false_tracks", "mostly_lost"),
        *("delay_mean", "count_error_rms"),
        *("TGOSPA", "TGOSPA_localisation", "TGOSPA_missed", "TGOSPA_false", "TGOSPA_switching"),
        # Milliseconds per frame.
        "ms",
    )
)
"""Of which less is better."""
HIGHER = frozenset(
    (
        *("MODA", "N_MODA", "MODP", "MOTA", "MOTA_log", "MOTP", "IDF1", "HOTA", "SFDA", "ATA", "DetA", "AssA", "IDP", "IDR"),
        *("N_MODA_detection", "ATA_matched", "matches", "mostly_tracked", "objects_found"),
    )
)
"""Of which more is better. What is in neither only counts, or is best at 0."""


def sense(name: str) -> str:
    """What is added to a sentence about a score of which less is better; nothing for the others."""
    return "; lower is better" if name in LOWER else ""
