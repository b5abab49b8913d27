"""What a run leaves to look at: the annotated video's frames, ``report.html``, ``run.json``."""

from phdtrack.report.drawing import Annotator, annotate
from phdtrack.report.pages import report_html, write_report
from phdtrack.report.record import About, HeatMap, Recorder, RunRecord, Series, density_map, sentences
from phdtrack.report.run_json import run_document, write_run

__all__ = [
    "About",
    "Annotator",
    "HeatMap",
    "Recorder",
    "RunRecord",
    "Series",
    "annotate",
    "density_map",
    "report_html",
    "run_document",
    "sentences",
    "write_report",
    "write_run",
]
