"""Methods compared on the same sequences, detections, clutter and seeds: a plan, its runs, a
summary with intervals.

made = plan(Request(["TUD-Campus", "KITTI-17"], filters=["particle-phd", "none"], clutter=[0, 10],
seeds=5)) comparison = run(made, folder, jobs)    keeps every run in the folder, and reuses what is
there summary(comparison)                     means over the seeds with intervals, per case and
pooled
"""

from phdtrack.compare.plans import Plan, Request, plan
from phdtrack.compare.runs import Comparison, run, steps
from phdtrack.compare.statistics import Row, check_scores, summary, widest

__all__ = [
    "Comparison",
    "Plan",
    "Request",
    "Row",
    "check_scores",
    "plan",
    "run",
    "steps",
    "summary",
    "widest",
]
