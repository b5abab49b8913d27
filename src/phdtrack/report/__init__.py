"""What a run leaves to look at: the annotated video's frames, ``report.html``, ``run.json``."""

from phdtrack.report.drawing import Annotator
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
