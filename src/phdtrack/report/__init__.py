"""The visible results of a run: frames of the annotated video, ``report.html``, ``run.json``."""

from phdtrack.report.annotator import Annotator
from phdtrack.report.pages import report_html, run_document, sentences, write_run
from phdtrack.report.record import About, Recorder, RunRecord

__all__ = [
    "About",
    "Annotator",
    "Recorder",
    "RunRecord",
    "report_html",
    "run_document",
    "sentences",
    "write_run",
]
