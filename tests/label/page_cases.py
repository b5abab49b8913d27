"""A labelling page in a process of its own, and a browser to look at it with."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np

SIZE = (640, 480)
FRAMES = 40

PROGRAM = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from page_cases import session
from phdtrack.label.label_page import label_app
from phdtrack.web.serving import listen, serve
address = listen(port={port})
print(address.url, flush=True)
waiting = {waiting_for!r} and Path({waiting_for!r})
serve(label_app(session(Path({labels!r}), {boxes}, waiting)), address)
"""


def session(labels: Path, boxes: int, waiting_for: Path | None = None):
    """A session on drawn frames: on each ``boxes`` detections on a grid, and a small one inside the
    first.

    Of box 3 it is suggested that its place fires, of box 4 that it was rejected; of the latter on
    every other frame only, and with a score below that of ticked ones on the frames behind 20. The
    suggestions are there when the file ``waiting_for`` is.
    """
    import cv2

    from phdtrack.label import LabelStore
    from phdtrack.label.label_page import Session
    from phdtrack.label.suggestions import Background, Suggestion
    from phdtrack.types import Detections, DetectionTable, SequenceInfo

    across = int(np.ceil(np.sqrt(boxes * 4 / 3)))
    step = 600 / across
    corner = np.array([(20 + step * (k % across), 20 + step * (k // across)) for k in range(boxes)])
    one = np.vstack(
        [np.hstack([corner, corner + 0.8 * step]), [[20 + 0.2 * step] * 2 + [20 + 0.5 * step] * 2]]
    )
    frame = np.repeat(np.arange(1, FRAMES + 1), len(one))
    table = DetectionTable(
        frame, Detections.of(np.tile(one, (FRAMES, 1)), np.full(len(frame), 0.5))
    )
    stills = {}
    for number in range(1, FRAMES + 1):
        image = np.full((SIZE[1], SIZE[0], 3), 60, np.uint8)
        cv2.putText(image, str(number), (250, 260), cv2.FONT_HERSHEY_SIMPLEX, 3, (200, 200, 200), 4)
        stills[number] = cv2.imencode(".jpg", image)[1].tobytes()
    store = LabelStore.open(labels, "drawn", "digest", list(range(1, FRAMES + 1)))
    numbers = range(1, FRAMES + 1)
    found = [Suggestion(number, 3, "place", 0.99, 0) for number in numbers]
    found += [
        Suggestion(number, 4, "rejected", 0.95 if number <= 20 else 0.5, -1)
        for number in numbers[::2]
    ]

    def waits(report):
        report(0.25)
        while waiting_for is not None and not waiting_for.exists():
            time.sleep(0.02)
        return found

    background = Background(waits)
    while waiting_for is None and background.found is None:
        time.sleep(0.001)
    command = f"phdtrack learn drawn.mp4 --labels {labels}"
    return Session(
        store, table, stills, SequenceInfo(*SIZE, 25.0, FRAMES, "drawn"), background, command
    )


@contextlib.contextmanager
def server(
    labels: Path, boxes: int = 12, port: int = 0, waiting_for: Path | None = None
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The page's address and the process that serves it, which may be killed inside."""
    program = PROGRAM.format(
        tests=str(Path(__file__).parent),
        labels=str(labels),
        boxes=boxes,
        port=port,
        waiting_for=waiting_for and str(waiting_for),
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:")
        for _ in range(100):
            with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=5):
                break
            time.sleep(0.05)
        yield url, process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
