"""Methods compared on the same sequences, detections, clutter and seeds: a plan, its runs, a summary with intervals.

plan(["TUD-Campus", "KITTI-17"], filters=["particle-phd", "none"], clutter=[0, 10], seeds=5)
run(plan, folder, jobs)     keeps every run in the folder, and takes up what is there
summary(comparison)         means over the seeds with intervals, per case and pooled
"""

from phdtrack.compare.engine import Comparison, run, steps
from phdtrack.compare.making import plan
from phdtrack.compare.parallel import Failed
from phdtrack.compare.records import Case, Cell, Detecting, Footage, Given, Method, Plan, Run
from phdtrack.compare.statistics import Interval, interval
from phdtrack.compare.store import Outcome
from phdtrack.compare.summary import Row, Summary, check_scores, summary

__all__ = [
    "Case",
    "Cell",
    "Comparison",
    "Detecting",
    "Failed",
    "Footage",
    "Given",
    "Interval",
    "Method",
    "Outcome",
    "Plan",
    "Row",
    "Run",
    "Summary",
    "check_scores",
    "interval",
    "plan",
    "run",
    "steps",
    "summary",
]
