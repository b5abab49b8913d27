"""Methods compared on the same sequences, detections, clutter and seeds: a plan, its runs, a summary with intervals.

plan(["TUD-Campus", "KITTI-17"], filters=["particle-phd", "none"], clutter=[0, 10], seeds=5)
run(plan, folder, jobs)     keeps every run in the folder, and reuses what is there
summary(comparison)         means over the seeds with intervals, per case and pooled
"""

from phdtrack.compare.plans import DetectionChoice, Plan, SettingsSource, plan
from phdtrack.compare.runs import Comparison, run, steps
from phdtrack.compare.statistics import Row, check_scores, summary, widest

__all__ = [
    "Comparison",
    "DetectionChoice",
    "Plan",
    "Row",
    "SettingsSource",
    "check_scores",
    "plan",
    "run",
    "steps",
    "summary",
    "widest",
]
