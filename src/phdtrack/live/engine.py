"""A camera at work: its source, detector, tracker and watch, in a thread of its own, and what is known of it right now."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.classes import Kinds
from phdtrack.devices import Detector
from phdtrack.errors import InputError
from phdtrack.live.delivery import Courier
from phdtrack.live.events import Event, Watch, WatchState
from phdtrack.live.outputs import EventLog, RowsLog, VideoLog, stamp
from phdtrack.live.sources import LiveFrame, LiveSource, SourceStatus
from phdtrack.live.zones import Place, read_places
from phdtrack.report import Annotator
from phdtrack.tracker import Tracker
from phdtrack.types import F8, Detections, Frame, I8, Image, SequenceInfo, Tracks

# Minutes of counts that are kept; cells of the maps across; a cell forgets half of what it knows in so many seconds.
MINUTES, CELLS, HALF_LIFE = 24 * 60, 64, 3600.0
# Frames whose times rows of an output delay may still ask for; latencies of which the percentiles are.
_WALLS, _LATENCIES = 512, 2048


class Making(NamedTuple):
    """What is made once the size of the pictures is known."""

    detector: Detector
    kinds: Kinds
    info: SequenceInfo


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a camera writes.

    Attributes
    ----------
    folder : of its files.
    places : file of lines and zones, read again when it changes; None for none.
    watch : without places.
    video : pictures a second of the annotated video; 0 for none.
    quota : bytes of rows, and of videos, that are kept; 0: all.
    parquet : hours of rows become Parquet.
    """

    folder: Path
    places: Path | None = None
    watch: Watch = field(default_factory=Watch)
    video: float = 5.0
    quota: int = 0
    parquet: bool = False


class Minute(NamedTuple):
    """The mean and the largest number of confirmed tracks in a minute, which begins at ``wall`` (UTC seconds)."""

    wall: float
    mean: float
    most: int


@dataclass(slots=True)
class Maps:
    """Where people were, and where false alarms, in cells of the picture (h, w); both fade with a half-life of an hour."""

    people: F8
    clutter: F8
    cell: float
    time: float = 0.0

    @classmethod
    def of(cls, width: int, height: int) -> Maps:
        """Empty maps of a picture."""
        cell = width / CELLS
        shape = (max(1, round(height / cell)), CELLS)
        return cls(np.zeros(shape), np.zeros(shape), cell)

    def add(self, time: float, feet: F8, xyxy: F8, probability: F8) -> None:
        """Take in the feet (n, 2) of tracks, and boxes (m, 4) with their probability of being false alarms."""
        fade = 0.5 ** ((time - self.time) / HALF_LIFE)
        self.time = time
        for grid, points, weight in (
            (self.people, feet, np.ones(len(feet))),
            (self.clutter, (xyxy[:, :2] + xyxy[:, 2:]) / 2, probability),
        ):
            grid *= fade
            at = (points[:, ::-1] / self.cell).astype(np.int64)
            inside = ((at >= 0) & (at < grid.shape)).all(axis=1)
            np.add.at(grid, tuple(at[inside].T), weight[inside])


class Camera:
    """One camera.

    Parameters
    ----------
    name : for files, events and the page.
    source : is started here.
    make : what makes detector and stages for pictures of a size.
    settings : what is written.
    send : called with each new event.
    """

    def __init__(
        self,
        name: str,
        source: LiveSource,
        make: Callable[[SequenceInfo], Making],
        settings: CameraSettings,
        send: Callable[[dict[str, object]], None] = lambda event: None,
    ) -> None:
        self.name, self.source, self.settings = name, source, settings
        self._make, self._send = make, send
        self._made: Making | None = None
        self._tracker: Tracker | None = None
        self._annotate: Annotator | None = None
        self.log = EventLog(settings.folder)
        self._rows = RowsLog(settings.folder / "tracks", settings.quota, parquet=settings.parquet)
        self._video = VideoLog(settings.folder / "video", settings.video, settings.quota) if settings.video else None
        self.watch, self._seen_places = settings.watch, 0.0
        self.state: WatchState = self.watch.start()
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self.problem = ""
        self.counted: dict[str, int] = {}
        self._walls: deque[tuple[int, float]] = deque(maxlen=_WALLS)
        self._latency: deque[float] = deque(maxlen=_LATENCIES)
        self.minutes: deque[Minute] = deque(maxlen=MINUTES)
        self._minute: list[int] = []
        self.maps: Maps | None = None
        self._shown: tuple[Image, Tracks, Detections, F8, int, float] | None = None
        self._couriers: list[Courier] = []
        self._thread = threading.Thread(target=self._run, name=f"phdtrack {name}", daemon=True)

    def start(self, couriers: list[Courier]) -> None:
        """Begin; ``couriers`` are told of new events."""
        self._couriers = couriers
        self.source.start()
        self._thread.start()

    def stop(self, patience: float = 1.5) -> None:
        """End, and complete the files."""
        self._stopped.set()
        self.source.stop()
        self._thread.join(patience)
        for courier in self._couriers:
            courier.stop(0.2)
        self._rows.finish()
        if self._video is not None:
            self._video.finish()
        self.log.close()

    def latency(self) -> tuple[float, float]:
        """Median and 99 % of the seconds from a picture's arrival to its events on disk; NaN where there was none."""
        held = list(self._latency)
        return (float(np.median(held)), float(np.quantile(held, 0.99))) if held else (np.nan, np.nan)

    def picture(self) -> Image | None:
        """(H, W, 3) the last picture with everything drawn on it; None where there is none yet."""
        with self._lock:
            shown = self._shown
        if shown is None or self._annotate is None:
            return None
        image, rows, found, probability, number, mass = shown
        return self._annotate(image, number, rows, found, mass=mass, clutter_probability=probability)

    def _run(self) -> None:
        while not self._stopped.is_set():
            self._reload()
            frame = self.source.next(0.25)
            if frame is None:
                continue
            try:
                self._take(frame)
                self.problem = ""
            except (InputError, OSError, ValueError) as error:
                # A camera that runs for months is not ended by one picture.
                self.problem = str(error)

    def _reload(self) -> None:
        """Read the places again where their file has changed; tracks and counts go on. A file that cannot be read changes nothing."""
        path = self.settings.places
        if path is None:
            return
        try:
            changed = path.stat().st_mtime
            if changed == self._seen_places:
                return
            self._seen_places = changed
            self._with(read_places(path))
        except (OSError, InputError) as error:
            self.problem = f"the lines and zones stay as they were: {error}"

    def _with(self, places: tuple[Place, ...]) -> None:
        before, old = self.watch, self.settings.watch
        self.watch = Watch(places, old.names, old.hysteresis, old.dwell, old.leave_after)
        self.state = self.watch.carried(self.state, before)

    def _take(self, frame: LiveFrame) -> None:
        """One picture through detector, tracker and watch, into all files."""
        arrived = time.monotonic()
        if self._tracker is None or self._made is None:
            height, width = frame.image.shape[:2]
            self._made = self._make(SequenceInfo(width, height, 25.0, 0, self.name))
            self._tracker = Tracker(stages=self._made.kinds, fps=25.0)
            self._annotate = Annotator(self._made.info, names=self.watch.names or None)
            self.maps = Maps.of(width, height)
        found = self._made.detector(Frame(frame.number, frame.time, frame.image))
        rows = self._tracker.update(found, frame.number, frame.time)
        step = self._tracker.step
        assert step is not None
        assert self.maps is not None
        self._walls.append((frame.number, frame.wall))
        self.state, events = self.watch.advance(self.state, rows, frame.number, frame.time)
        self._write(rows, events, frame)
        self._latency.append(time.monotonic() - arrived)
        confirmed = rows.take(rows.confirmed)
        feet = np.stack([(confirmed.xyxy[:, 0] + confirmed.xyxy[:, 2]) / 2, confirmed.xyxy[:, 3]], axis=1)
        probability = step.info.clutter_probability
        known = probability if len(probability) == len(step.detections) else np.zeros(len(step.detections))
        self.maps.add(frame.time, feet, step.detections.xyxy, known)
        self._count(len(confirmed), frame.wall)
        with self._lock:
            self._shown = (frame.image, rows, step.detections, probability, step.number, step.info.mass)
        if self._video is not None:
            picture = self.picture()
            assert picture is not None
            self._video.write(picture, frame.wall)

    def _write(self, rows: Tracks, events: tuple[Event, ...], frame: LiveFrame) -> None:
        """Rows to their hour, events to the log, and word of them to everybody."""
        walls = dict(self._walls)
        self._rows.write(rows, [walls.get(number, frame.wall) for number in rows.frame.tolist()])
        if not events:
            return
        wall, names = stamp(frame.wall), self.watch.names
        for event in self.log.write(one.as_dict(self.name, wall, names) for one in events):
            kind = str(event["kind"])
            self.counted[kind] = self.counted.get(kind, 0) + 1
            self._send(event)
        for courier in self._couriers:
            courier.wake()

    def _count(self, tracks: int, wall: float) -> None:
        """Add to the present minute."""
        start = wall // 60 * 60
        if not self.minutes or self.minutes[-1].wall != start:
            self._minute = []
            self.minutes.append(Minute(start, 0.0, 0))
        self._minute.append(tracks)
        self.minutes[-1] = Minute(start, sum(self._minute) / len(self._minute), max(self._minute))
