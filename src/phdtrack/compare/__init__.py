"""Comparison of methods on the same sequences, detections, clutter and seeds.

    made = plan(Request(["TUD-Campus", "KITTI-17"], filters=["particle-phd", "none"], seeds=5))
    comparison = run(made, folder, jobs)
    rows = summary(comparison)

`run` keeps every run in the folder and reuses those that are there. `summary` gives means over the
seeds with confidence intervals, for each case and pooled.
"""

from phdtrack.compare.planning import plan
from phdtrack.compare.plans import Plan, Request
from phdtrack.compare.runs import Comparison, run, steps
from phdtrack.compare.statistics import Row, check_scores, over_sequences, summary, widest

__all__ = [
    "Comparison",
    "Plan",
    "Request",
    "Row",
    "check_scores",
    "over_sequences",
    "plan",
    "run",
    "steps",
    "summary",
    "widest",
]
