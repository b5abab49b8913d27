"""A camera at work: its source, detector, tracker and watch, in a thread of its own, and its
current state.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.addresses import shown
from phdtrack.arrays import pixelated
from phdtrack.detect.base import Describer, Detector
from phdtrack.detect.convert import DiscardedBoxes
from phdtrack.errors import InputError
from phdtrack.groups.group_stages import GroupStages, OnlineGroups
from phdtrack.live.checkpoint import (
    LOST,
    Checkpoints,
    HeldFrame,
    SavedCamera,
    SavedWatch,
    key_of,
    load,
)
from phdtrack.live.delivery import Courier
from phdtrack.live.events import Event, Maps, Minute, Watch, WatchState
from phdtrack.live.outputs import EventLog, RowsLog, SnapshotLog, VideoLog, stamp
from phdtrack.live.overload import Load, Overload
from phdtrack.live.zones import place_doubts, read_places
from phdtrack.multiclass import ClassSettings
from phdtrack.opencv_package import cv2
from phdtrack.report import Annotator
from phdtrack.report.drawing import feet
from phdtrack.run.camera_motion import Mover
from phdtrack.run.loop import NO_PICTURE, FrameObserver, detect_frames, track_frame
from phdtrack.tracker import Tracker
from phdtrack.types import (
    Detections,
    Estimates,
    Frame,
    GaussianMixture,
    Image,
    SequenceInfo,
    Step,
    Tracks,
    UpdateInfo,
)
from phdtrack.video.live_sources import LiveFrame, LiveSource

# Minutes of counts that are kept; cells of the maps across; a cell forgets half of what it knows in
# so many seconds.
MINUTES = 24 * 60
# Latencies of which the percentiles are; events to show, and to write again after a full disk.
MAX_LATENCIES = 2048
MAX_RECENT = 200
_UNWRITTEN = 1000
# Pictures, or seconds, from which the rate of a source is taken; seconds for which a page that
# asked is drawn for.
_MEASURED = 10
_MEASURING = 2.0
_WATCHED = 3.0
# Seconds without a picture, or a tracked one, after which a camera is not healthy.
UNHEALTHY = 30.0
# Seconds after a picture that failed: where all do, the processor is not for them alone; until
# events that could not be written are tried again; for which a file must be as it is before it is
# read again: it may be written in place.
_REST = 0.05
_AGAIN = 1.0
_SETTLED = 0.5
_SNAPSHOT_QUALITY = 85


class CameraParts(NamedTuple):
    """The parts of a camera, made once the size of its pictures is known.

    Attributes
    ----------
    detector, classes, info : the detector, the stages of each class, and the sequence.
    delay : frames by which online rows lag.
    fixed : settings, by name, that cannot change while it runs.
    groups : None if people are not tracked on the ground.
    seed : of everything random.
    mover : the camera's motion; None for a camera that stands still.
    describer : describes the appearance of boxes; None if it is not used.
    """

    detector: Detector
    classes: ClassSettings
    info: SequenceInfo
    delay: int = 0
    fixed: Mapping[str, object] = {}
    groups: GroupStages | None = None
    seed: int = 0
    mover: Mover | None = None
    describer: Describer | None = None


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """The settings of a camera.

    Attributes
    ----------
    folder : of its files.
    places, config : files of lines and zones, and of settings, read again when they change; None
        for none.
    watch : everything that is watched except the places.
    video : pictures a second of the annotated video; 0 for none.
    quota : bytes of rows, and of videos, that are kept; 0: all.
    parquet : hours of rows become Parquet.
    blur : ``boxes`` or ``faces`` to pixelate them in every picture; empty for nothing.
    checkpoint : seconds between checkpoints, from which a restart continues; 0 for none.
    reports : a sentence about what the detector reports, if that is not objects.
    snapshots : pictures of events at lines and zones that are kept; 0: none.
    """

    folder: Path
    places: Path | None = None
    config: Path | None = None
    watch: Watch = field(default_factory=Watch)
    video: float = 5.0
    quota: int = 0
    parquet: bool = False
    blur: str = ""
    checkpoint: float = 0.0
    reports: str = ""
    snapshots: int = 0


class Running(NamedTuple):
    """The parts of a camera once the size of its pictures is known.

    Attributes
    ----------
    parts, tracker : the parts, and the tracker made of them.
    groups : finds groups; None if people are not tracked on the ground.
    annotate : draws on pictures.
    maps : of people and of false alarms.
    """

    parts: CameraParts
    tracker: Tracker
    groups: OnlineGroups | None
    annotate: Annotator
    maps: Maps


class _HeldFrame(NamedTuple):
    """A frame whose rows are not final yet."""

    frame: LiveFrame
    step: Step
    mixture: GaussianMixture | None


class _WatchedFile:
    """A file that is read again when it has changed; ``use`` is called with its path."""

    def __init__(self, path: Path | None, use: Callable[[Path], None]) -> None:
        self._path = path
        self._use = use
        # Time and size of the file when it was read, and of a change and since when it is there.
        self._read: tuple[int, int] | None = None
        self._change: tuple[int, int] | None = None
        self._since = 0.0

    def read_if_changed(self, now: float) -> bool:
        """Read the file if it has changed and stayed so for a while; whether it was read. Raises
        whatever ``use`` raises.
        """
        if self._path is None:
            return False
        # The size too: times of files are coarse.
        state = (self._path.stat().st_mtime_ns, self._path.stat().st_size)
        if state == self._read:
            return False
        if state != self._change:
            self._change = state
            self._since = now
        if self._read is not None and now < self._since + _SETTLED:
            return False
        self._read = state
        self._use(self._path)
        return True


class Camera:
    """One camera.

    Parameters
    ----------
    name : for files, events and the page.
    source : is started by `start`.
    make : makes the parts for pictures of a size; called again when the file of settings has
        changed.
    settings : what is watched and written.
    send : called with each new event, in the camera's thread.
    observers : take in every frame behind the tracker, in the camera's thread.
    clock : seconds that only grow.
    """

    def __init__(
        self,
        name: str,
        source: LiveSource,
        make: Callable[[SequenceInfo], CameraParts],
        settings: CameraSettings,
        send: Callable[[dict[str, object]], None] = lambda event: None,
        observers: Sequence[FrameObserver] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.source = source
        self.settings = settings
        self._make = make
        self._send = send
        self._observers = observers
        self._clock = clock
        self.running: Running | None = None
        """What it works with; None before the first picture."""
        self.checkpoints = Checkpoints(settings.folder, settings.checkpoint, clock)
        self.log = EventLog(settings.folder)
        self.rows = RowsLog(settings.folder / "tracks", settings.quota, parquet=settings.parquet)
        self._video = _video_log(settings)
        self.snapshots = SnapshotLog(settings.folder / "snapshots", settings.snapshots)
        self.watched: tuple[Watch, WatchState] = (settings.watch, settings.watch.start())
        """The settings of what is watched, and its state: who is there, and the counts."""
        # What went wrong, by what it concerns.
        self._problems = dict[str, str]()
        self.warnings = list[str]()
        """The warnings of the tracker and about lines and zones, of which there are few."""
        self._files_read = {
            "places": _WatchedFile(settings.places, self._places),
            "settings": _WatchedFile(settings.config, self._settings),
        }
        self._load = Overload(clock())
        # Time from which on events that could not be written are written again.
        self._patient = 0.0
        self._stopped = threading.Event()
        self._files = threading.Lock()
        self._open = True
        self._held = deque[_HeldFrame]()
        self._unwritten = deque[dict[str, object]](maxlen=_UNWRITTEN)
        self._latency = deque[float](maxlen=MAX_LATENCIES)
        self._begun = 0.0
        # Differences of the source's numbers and times and those of tracks, which go on after a
        # restart; the time of the last frame of the run before; number, time and time of day of the
        # last frame; the last one with rows.
        self._ahead = (0, 0.0, -math.inf)
        self._last = (0, 0.0, 0.0)
        self._finished = 0
        self.minutes = deque[Minute](maxlen=MINUTES)
        self.recent = deque[dict[str, object]](maxlen=MAX_RECENT)
        self.counted = Counter[str]()
        self.frames = 0
        self.tracks = 0
        self._fresh = threading.Condition()
        self._asked = -np.inf
        self._drawn: tuple[int, Image | None] = (0, None)
        self.ground: Image | None = None
        """(H, W, 3) a picture to draw maps on."""
        self._couriers: Sequence[Courier] = ()
        self._thread = threading.Thread(target=self._run, name=f"phdtrack {name}", daemon=True)

    def start(self, couriers: Sequence[Courier] = ()) -> None:
        """Begin; ``couriers`` are woken for new events."""
        self._couriers = couriers
        self._load.tracked = self._clock()
        self._reload()
        self.source.start()
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Ask it to end; `stop` waits for it."""
        self._stopped.set()
        self.source.stop()

    def stop(self, patience: float = 1.0) -> bool:
        """End it; whether all files are complete. A thread that hangs longer than ``patience``
        seconds is left behind.
        """
        self.ask_to_stop()
        end = self._clock() + patience
        if self._thread.ident is not None:
            self._thread.join(patience)
        for courier in self._couriers:
            courier.stop(max(0.0, min(0.2, end - self._clock())))
        if not self._files.acquire(timeout=0.2):
            return False
        with self._fresh:
            self._fresh.notify_all()
        try:
            steps = [self._flush, lambda: self._tell((), last=True), self.rows.finish]
            steps += [] if self._video is None else [self._video.finish]
            done = [self._tried(step) for step in (*steps, self.log.close, self._save_end)]
            return all(done) and not self._unwritten
        finally:
            self._open = False
            self._files.release()

    def _tried(self, step: Callable[[], None]) -> bool:
        """Do it; whether it succeeded. The other files, and cameras, are still to be completed."""
        try:
            step()
        except Exception as error:
            self._problems["files"] = str(error) or type(error).__name__
            return False
        return True

    def _flush(self) -> None:
        """Write the rows of the frames that are held."""
        if self._open and self.running is not None and not self.alive:
            rows = self.running.tracker.flush()
            while self._held:
                held = self._held.popleft()
                self._finish(self.running, held, rows.select(rows.frame == held.frame.number))

    def _save_end(self) -> None:
        """Save the last checkpoint."""
        whole = self._open and not self.alive and not self._unwritten
        if self.settings.checkpoint and self._last[0] and whole:
            self.save(ended=True)

    @property
    def returned(self) -> int:
        """The number of objects that have got their identities again since it was started."""
        if self.running is None:
            return 0
        before = self._ahead[2]
        pairs = self.running.tracker.returns
        return len({one.identity for one in pairs if one.time > before})

    @property
    def alive(self) -> bool:
        """True while its thread works."""
        return self._thread.is_alive()

    @property
    def working(self) -> bool:
        """True if its last picture was processed without an error, if there was one."""
        return self.alive and "frame" not in self._problems

    @property
    def untracked(self) -> float:
        """Seconds since a picture was tracked, or since it was started if none was."""
        return self._clock() - self._load.tracked

    @property
    def problems(self) -> list[str]:
        """Everything that is not as it should be, in sentences without secrets."""
        waiting = [
            f"events wait to be sent: {one.problem}" for one in self._couriers if one.problem
        ]
        return [
            shown(sentence)
            for sentence in (
                *self._problems.values(),
                self._overload(),
                self.checkpoints.problem,
                self.log.problem,
                *waiting,
            )
            if sentence
        ]

    def _overload(self) -> str:
        """A sentence if most pictures of the last half minute were dropped, empty otherwise."""
        # Those that arrive while kernels are compiled for the first one do not count.
        if not self.frames:
            return ""
        status = self.source.status()
        return self._load.update(Load(self._clock(), status.frames, status.dropped, self.frames))

    @property
    def left_out(self) -> DiscardedBoxes:
        """How many boxes were left out, and why."""
        if self.running is None:
            return DiscardedBoxes()
        return self.running.tracker.left_out

    def latency(self) -> tuple[float, float]:
        """Median and 99 % of the seconds from a picture's arrival to its events on disk; NaN if
        there was none.
        """
        held = list(self._latency)
        if held:
            return (float(np.median(held)), float(np.quantile(held, 0.99)))
        return (np.nan, np.nan)

    def picture(self, after: int = 0, patience: float = 0.0) -> tuple[int, Image | None]:
        """The newest drawn picture and the number of its frame; one after ``after`` if it is drawn
        within ``patience`` seconds.

        Pictures are drawn while somebody asks for them.
        """
        with self._fresh:
            self._asked = self._clock()
            self._fresh.wait_for(lambda: self._drawn[0] > after or self._stopped.is_set(), patience)
            return self._drawn

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                self._reload()
                frame = self.source.next(0.25)
                if frame is not None:
                    self.process(frame)
                    self._problems.pop("frame", None)
            except Exception as error:
                # A camera that runs for months is not ended by one picture, or by a full disk.
                self._problems["frame"] = str(error) or type(error).__name__
                self._stopped.wait(_REST)

    def _reload(self) -> None:
        """Read places and settings again if their files have changed; tracks and counts go on.

        A file that cannot be used changes nothing, and is reported.
        """
        for name, file in self._files_read.items():
            try:
                if file.read_if_changed(self._clock()):
                    self._problems.pop(name, None)
            except FileNotFoundError:
                continue
            except Exception as error:
                self._problems[name] = (
                    f"the {name} stay as they were: {str(error) or type(error).__name__}"
                )

    def _places(self, path: Path) -> None:
        before, state = self.watched
        watch = replace(before, places=read_places(path))
        self.watched = (watch, watch.carried(state, before))
        self._doubt_places()

    def _doubt_places(self) -> None:
        """Warn, once, of places that count nothing."""
        watch, _ = self.watched
        size = (0, 0)
        if self.running is not None:
            size = (self.running.parts.info.width, self.running.parts.info.height)
        for sentence in place_doubts(watch.places, set(watch.names.values()), size):
            if sentence not in self.warnings:
                self.warnings.append(sentence)

    def _settings(self, path: Path) -> None:
        """Continue the tracks with other settings. Raises `InputError` for those that cannot
        change.
        """
        running = self.running
        if running is None:
            return
        parts = self._make(running.parts.info)
        fixed = running.parts.fixed
        names = [
            name
            for name in sorted({*fixed, *parts.fixed})
            if fixed.get(name) != parts.fixed.get(name)
        ]
        if names:
            problem = f"{', '.join(names)} cannot change while it runs"
            raise InputError(problem, where=path, cure="End it and start it again.")
        tracker = self._tracker(parts)
        tracker.load_state_dict(running.tracker.state_dict(), same_settings=False)
        # Detector and motion go on with what they know of the last picture.
        before = running.parts
        parts = parts._replace(
            detector=before.detector, mover=before.mover, describer=before.describer
        )
        self.running = running._replace(parts=parts, tracker=tracker)

    def _tracker(self, parts: CameraParts) -> Tracker:
        """A tracker that is warm, and whose warnings are those of the camera."""
        tracker = Tracker(stages=parts.classes, fps=parts.info.fps, seed=parts.seed)
        tracker.on_warning = self.warnings.append
        # Pictures come when they come, and connections break.
        tracker.trust_times()
        tracker.warm_up()
        return tracker

    def _begin(self, frame: LiveFrame, fps: float) -> Running:
        """The parts for the size of the first picture, and a tracker, which continues from the
        last checkpoint.
        """
        height, width = frame.image.shape[:2]
        parts = self._make(SequenceInfo(width, height, round(max(fps, 1.0), 1), 0, self.name))
        tracker = self._tracker(parts)
        groups = None
        if parts.groups is not None:
            first = self.log.highest("group") + 1
            groups = OnlineGroups(parts.groups, parts.classes.usual, first)
        names = self.watched[0].names or None
        annotate = Annotator(parts.info, names=names, blur=self.settings.blur)
        running = Running(parts, tracker, groups, annotate, Maps.of(width, height))
        if self.settings.checkpoint:
            self._resume(running, frame)
        return running

    def process(self, frame: LiveFrame) -> None:
        """Send a picture through detector, tracker and watch, into all files. `start` does so with
        each picture of the source.
        """
        if self.running is None:
            status = self.source.status()
            self._begun = self._begun or self._clock()
            if status.frames < _MEASURED and self._clock() - self._begun < _MEASURING:
                return
            # If this fails the next picture begins anew: a half of it would be saved as all there
            # is.
            self.running = self._begin(frame, status.fps)
            self._doubt_places()
        running = self.running
        parts = running.parts
        frame = frame._replace(
            number=frame.number + self._ahead[0], time=frame.time + self._ahead[1]
        )
        picture = Frame(frame.number, frame.time, frame.image)
        for detected in detect_frames(parts.detector, (picture,), parts.mover, parts.describer):
            tracked = track_frame(running.tracker, detected)
            for observer in self._observers:
                observer.take(tracked)
        step = tracked.step
        mixture = None
        if running.groups is not None:
            mixture = running.groups.mixture(tracked.state.intensity, step)
        self._held.append(_HeldFrame(frame, step, mixture))
        self.frames = self.frames + 1
        self._load.tracked = self._clock()
        self._overload()
        self._last = (frame.number, frame.time, frame.wall)
        if len(self._held) > parts.delay:
            held = self._held.popleft()
            with self._files:
                # When it was stopped while it hung, its files are complete already.
                if self._open:
                    self._finish(running, held, tracked.rows)
        # A checkpoint with events that are not written would lose them.
        if self.checkpoints.due and not self._unwritten:
            self.checkpoints.write_beside(*self._state())

    def save(self, *, ended: bool = False) -> None:
        """Write a checkpoint now. ``ended``: no identity will be given after it."""
        self.checkpoints.wait()
        self.checkpoints.write(*self._state(), ended=ended)

    def _state(self) -> tuple[str, Callable[[], dict[str, Any]], SavedCamera, int]:
        """The present state, as `Checkpoints.write` takes it, later and in any thread."""
        running = self.running
        assert running is not None
        info = running.parts.info
        maps = running.maps
        watch, state = self.watched
        held = tuple(
            HeldFrame(f.number, f.time, f.wall, step.detections.xyxy) for f, step, _ in self._held
        )
        pictures = (maps.people.copy(), maps.clutter.copy(), maps.time)
        minutes = np.array(self.minutes).reshape(-1, 4)
        return (
            key_of(running.parts.fixed, info.width, info.height),
            running.tracker.snapshot(),
            SavedCamera(*self._last, watch.places, state, held, *pictures, minutes),
            running.tracker.highest,
        )

    def _resume(self, running: Running, frame: LiveFrame) -> None:
        """Continue from the checkpoint of an earlier run. If it cannot be used that is reported,
        and its identities are not used again.
        """
        info = running.parts.info
        highest = self.log.highest() + LOST
        try:
            saved = load(self.settings.folder, key_of(running.parts.fixed, info.width, info.height))
            if saved is None:
                self.log.forget_watched()
                running.tracker.skip_identities(highest if highest > LOST else 0)
                return
            highest = max(saved[0], highest)
            if isinstance(saved[3], InputError):
                raise saved[3]
            self._restore(running, frame, highest, saved[1], saved[2], saved[3])
        except InputError as error:
            # The next checkpoint takes this sentence away: not at once.
            self.checkpoints.postpone()
            self.checkpoints.problem = (
                f"the checkpoint cannot be used, tracks and counts begin anew: {error}"
            )
            self.log.forget_watched()
            running.tracker.skip_identities(highest)

    def _restore(
        self,
        running: Running,
        frame: LiveFrame,
        highest: int,
        ended: bool,
        packed: dict[str, Any],
        saved: SavedCamera,
    ) -> None:
        """Restore a checkpoint. Raises `InputError` if it cannot be used; nothing is changed then.

        Parameters
        ----------
        running : gets the state of the tracker, and the maps.
        frame : the first of this run.
        highest : identity that an earlier run may have used.
        ended : whether the earlier run ended in order.
        packed, saved : state of its tracker, and of everything else.
        """
        tracker = running.tracker
        maps = running.maps
        if saved.people.shape != maps.people.shape:
            raise InputError("its maps are of another picture")
        # A run that was killed went on after its checkpoint: up to the last event, and up to the
        # last row.
        number, content = self.log.watched() or (0, b"")
        known = SavedWatch(saved.places, saved.watch)
        if number >= (saved.held[0].number if saved.held else saved.number + 1):
            known = SavedWatch.read(content, self.settings.folder)
        last = max(number, self.rows.last_frame())
        tracker.load_state_dict(packed, same_settings=False)
        # A run that was killed before its first checkpoint may have followed one that ended in
        # order.
        if not ended or last > saved.number:
            tracker.skip_identities(highest - tracker.highest)
        interval = max(frame.wall - saved.wall, 1 / running.parts.info.fps)
        self._ahead = (
            max(saved.number, last) + 1 - frame.number,
            saved.time + interval - frame.time,
            saved.time,
        )
        watch, _ = self.watched
        self.watched = (watch, watch.carried(known.state, replace(watch, places=known.places)))
        maps.people = saved.people
        maps.clutter = saved.clutter
        maps.time = saved.mapped
        self.minutes.extend(
            Minute(wall, mean, int(most), int(count))
            for wall, mean, most, count in saved.minutes.tolist()
        )
        self._held.extend(_held_frame(one) for one in saved.held if one.number > last)

    def _finish(self, running: Running, held: _HeldFrame, rows: Tracks) -> None:
        """Handle a frame whose rows are final: events, files, counts, maps, picture."""
        frame = held.frame
        step = held.step
        watch, state = self.watched
        state, events = watch.advance(state, rows, frame.number, frame.time)
        self.watched = (watch, state)
        confirmed = rows.select(rows.confirmed)
        if running.groups is not None and held.mixture is not None:
            found = running.groups.events(held.mixture, confirmed, frame.number, frame.time)
            events = (
                *events,
                *(Event.of_group(one, k) for k, one in enumerate(found, len(events))),
            )
        self._finished = frame.number
        picture: Image | None = None
        snapshot: Path | None = None
        pictured = self.settings.snapshots and frame.image.size
        if pictured and any(one.place for one in events):
            picture = _annotated(running, held, rows)
            snapshot = self._saved(picture, frame)
        self._tell(events, frame.wall, snapshot)
        self.rows.write(rows, frame.wall)
        self._latency.append(max(0.0, time.time() - frame.wall))
        probability = step.info.clutter_probability
        known = probability
        if len(probability) != len(step.detections):
            known = np.zeros(len(step.detections))
        running.maps.add(frame.time, feet(confirmed.xyxy), step.detections.xyxy, known)
        self.tracks = len(confirmed)
        Minute.add(self.minutes, len(confirmed), frame.wall)
        if not frame.image.size:
            # The frame is of an earlier run.
            return
        recorded = self._video is not None and self._video.due(frame.wall)
        if not recorded and self._clock() - self._asked > _WATCHED:
            return
        if picture is None:
            picture = _annotated(running, held, rows)
        with self._fresh:
            boxes = np.vstack([rows.xyxy, step.detections.xyxy])
            self._drawn = (frame.number, picture)
            self.ground = pixelated(frame.image, boxes, self.settings.blur)
            self._fresh.notify_all()
        if recorded and self._video is not None:
            self._video.write(picture, frame.wall)

    def _saved(self, picture: Image, frame: LiveFrame) -> Path | None:
        """The file of the picture of an event; None if it cannot be written, which is reported."""
        data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _SNAPSHOT_QUALITY])[1]
        try:
            file = self.snapshots.write(data.tobytes(), frame.number, frame.wall)
        except OSError as error:
            self._problems["snapshots"] = f"a picture of an event cannot be written: {error}"
            return None
        self._problems.pop("snapshots", None)
        return file

    def _tell(
        self,
        events: Sequence[Event],
        wall: float = 0.0,
        snapshot: Path | None = None,
        *,
        last: bool = False,
    ) -> None:
        """Log the events of a frame and report them. Events that could not be written come first
        the next time, or now if it is the ``last`` one.

        Parameters
        ----------
        events, wall : of a frame, and its seconds since 1970.
        snapshot : its picture, if there is one.
        """
        watch, state = self.watched
        for one in events:
            told = one.as_dict(self.name, stamp(wall), watch.names)
            if snapshot is not None and one.place:
                told["snapshot"] = snapshot.relative_to(self.settings.folder).as_posix()
            self._unwritten.append(told)
        if not (self._unwritten or self.log.problem) or (
            self._clock() < self._patient and not last
        ):
            return
        # Not with each picture: another process that holds the table keeps this one waiting.
        self._patient = self._clock() + _AGAIN
        try:
            saved = None
            if self.settings.checkpoint:
                saved = (self._finished, SavedWatch(watch.places, state).content())
            fresh = self.log.write(self._unwritten, saved)
        except Exception as error:
            self._problems["events"] = (
                f"events are still to be written, the last {_UNWRITTEN} are kept: {error}"
            )
            return
        self._problems.pop("events", None)
        if not self.log.problem:
            self._patient = 0.0
        for event in fresh:
            self.counted[str(event["kind"])] += 1
            self.recent.append(event)
            self._send(event)
        self._unwritten.clear()
        for courier in self._couriers:
            courier.wake()


def _video_log(settings: CameraSettings) -> VideoLog | None:
    """The log of the annotated videos; None if there are none."""
    if not settings.video:
        return None
    return VideoLog(settings.folder / "video", settings.video, settings.quota)


def _annotated(running: Running, held: _HeldFrame, rows: Tracks) -> Image:
    """The picture of a frame with its rows."""
    return running.annotate(
        held.frame.image,
        held.frame.number,
        rows,
        held.step.detections,
        mass=held.step.info.mass,
        clutter_probability=held.step.info.clutter_probability,
        time=held.frame.time,
    )


def _held_frame(saved: HeldFrame) -> _HeldFrame:
    """A frame of an earlier run whose rows are not final yet; its picture is not known any more."""
    nothing = UpdateInfo.without_update(0.0)
    detections = Detections.of(saved.xyxy)
    empty = Estimates.empty(0)
    step = Step(saved.number, saved.time, detections, nothing, empty, Tracks.empty())
    return _HeldFrame(LiveFrame(saved.number, saved.time, saved.wall, NO_PICTURE), step, None)
