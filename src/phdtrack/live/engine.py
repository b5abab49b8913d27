"""A camera at work: its source, detector, tracker and watch, in a thread of its own, and what is
known of it right now.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.detect.base import Detector
from phdtrack.detect.convert import LeftOut
from phdtrack.errors import InputError, shown
from phdtrack.groups.group_stages import GroupStages, OnlineGroups
from phdtrack.live.checkpoint import LOST, HeldFrame, SavedCamera, SavedWatch, key_of, load, save
from phdtrack.live.delivery import Courier
from phdtrack.live.events import Event, Maps, Minute, Watch, WatchState
from phdtrack.live.outputs import EventLog, RowsLog, VideoLog, stamp
from phdtrack.live.zones import read_places
from phdtrack.multiclass import ClassSettings
from phdtrack.report import Annotator
from phdtrack.report.drawing import feet
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
_LATENCIES = 2048
_EVENTS = 200
_UNWRITTEN = 1000
# Pictures, or seconds, from which the rate of a source is taken; seconds for which a page that
# asked is drawn for.
_MEASURED = 10
_MEASURING = 2.0
_WATCHED = 3.0
# Seconds after a picture that failed: where all do, the processor is not for them alone; until
# events that could not be written are tried again; for which a file must be as it is before it is
# read again: it may be written in place.
_REST = 0.05
_AGAIN = 1.0
_SETTLED = 0.5


class Making(NamedTuple):
    """What is made once the size of the pictures is known.

    Attributes
    ----------
    delay : frames by which online rows come late.
    fixed : settings, by name, that cannot change while it runs.
    groups : None where people are not followed on the ground.
    seed : of everything random.
    """

    detector: Detector
    kinds: ClassSettings
    info: SequenceInfo
    delay: int = 0
    fixed: Mapping[str, object] = {}
    groups: GroupStages | None = None
    seed: int = 0


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a camera watches and writes.

    Attributes
    ----------
    folder : of its files.
    places, config : files of lines and zones, and of settings, read again when they change; None
        for none.
    watch : without places.
    video : pictures a second of the annotated video; 0 for none.
    quota : bytes of rows, and of videos, that are kept; 0: all.
    parquet : hours of rows become Parquet.
    blur : what is made unrecognisable in every picture: ``boxes``, ``faces`` or nothing.
    checkpoint : seconds between two times that all is saved from which a restart goes on; 0 for
        never.
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


class _Held(NamedTuple):
    """A frame whose rows are not known yet."""

    frame: LiveFrame
    step: Step
    mixture: GaussianMixture | None


class Camera:
    """One camera.

    Parameters
    ----------
    name : for files, events and the page.
    source : is started by `start`.
    make : what makes detector and stages for pictures of a size; asked again when the file of
        settings has changed.
    settings : what is watched and written.
    send : called with each new event, in the camera's thread.
    """

    def __init__(
        self,
        name: str,
        source: LiveSource,
        make: Callable[[SequenceInfo], Making],
        settings: CameraSettings,
        send: Callable[[dict[str, object]], None] = lambda event: None,
    ) -> None:
        self.name = name
        self.source = source
        self.settings = settings
        self._make = make
        self._send = send
        self._made: Making | None = None
        self._tracker: Tracker | None = None
        self._groups: OnlineGroups | None = None
        self.log = EventLog(settings.folder)
        self._rows = RowsLog(settings.folder / "tracks", settings.quota, parquet=settings.parquet)
        self._video: VideoLog | None = None
        if settings.video:
            self._video = VideoLog(settings.folder / "video", settings.video, settings.quota)
        self.watched: tuple[Watch, WatchState] = (settings.watch, settings.watch.start())
        """The settings of what is watched, and its state: who is there, and the counts."""
        # What went wrong, by what it concerns; when each file was changed that was read.
        self._problems = dict[str, str]()
        self._seen = dict[str, tuple[int, int]]()
        # Time and size of a file that is to be read again, and since when they are so; from when on
        # events are tried again that could not be written.
        self._changing = dict[str, tuple[tuple[int, int], float]]()
        self._patient = 0.0
        self._stopped = threading.Event()
        self._files = threading.Lock()
        self._open = True
        self._held = deque[_Held]()
        self._unwritten = deque[dict[str, object]](maxlen=_UNWRITTEN)
        self._latency = deque[float](maxlen=_LATENCIES)
        self._begun = 0.0
        # Of the next checkpoint the time, and what writes the last one; what lies between the
        # source's numbers and times and those of tracks, which go on after a restart; number, time
        # and time of day of the last frame; the last one with rows.
        self._due = 0.0
        self._saving = threading.Thread()
        self._ahead = (0, 0.0)
        self._last = (0, 0.0, 0.0)
        self._finished = 0
        self.minutes = deque[Minute](maxlen=MINUTES)
        self.recent = deque[dict[str, object]](maxlen=_EVENTS)
        self.counted = Counter[str]()
        self.frames = 0
        self.tracks = 0
        self.maps: Maps | None = None
        self._fresh = threading.Condition()
        self._asked = -np.inf
        self._drawn: tuple[int, Image | None] = (0, None)
        self.ground: Image | None = None
        """(H, W, 3) a picture to draw maps on."""
        self._couriers: Sequence[Courier] = ()
        self._thread = threading.Thread(target=self._run, name=f"phdtrack {name}", daemon=True)

    def start(self, couriers: Sequence[Courier] = ()) -> None:
        """Begin; ``couriers`` are told of new events."""
        self._couriers = couriers
        self._reload()
        self.source.start()
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Say that it is to end; `stop` waits for it."""
        self._stopped.set()
        self.source.stop()

    def stop(self, patience: float = 1.0) -> bool:
        """End, and whether all files are complete. What hangs longer than ``patience`` seconds is
        left behind.
        """
        self.ask_to_stop()
        end = time.monotonic() + patience
        if self._thread.ident is not None:
            self._thread.join(patience)
        for courier in self._couriers:
            courier.stop(max(0.0, min(0.2, end - time.monotonic())))
        if not self._files.acquire(timeout=0.2):
            return False
        with self._fresh:
            self._fresh.notify_all()
        try:
            steps = [self._flush, lambda: self._tell((), last=True), self._rows.finish]
            steps += [] if self._video is None else [self._video.finish]
            done = [self._tried(step) for step in (*steps, self.log.close, self._save_end)]
            return all(done) and not self._unwritten
        finally:
            self._open = False
            self._files.release()

    def _tried(self, step: Callable[[], None]) -> bool:
        """Whether it was done: the other files, and the other cameras, are still to be
        completed.
        """
        try:
            step()
        except Exception as error:
            self._problems["files"] = str(error) or type(error).__name__
            return False
        return True

    def _flush(self) -> None:
        """The rows of the frames that are held."""
        if self._open and self._tracker is not None and not self._thread.is_alive():
            rows = self._tracker.flush()
            while self._held:
                held = self._held.popleft()
                self._finish(held, rows.select(rows.frame == held.frame.number))

    def _save_end(self) -> None:
        """The last checkpoint."""
        whole = self._open and not self._thread.is_alive() and not self._unwritten
        if self.settings.checkpoint and self._last[0] and whole:
            if self._saving.ident is not None:
                self._saving.join()
            self._saver(ended=True)()

    @property
    def alive(self) -> bool:
        """Whether its thread works."""
        return self._thread.is_alive()

    @property
    def working(self) -> bool:
        """Whether its last picture was worked on without an error, if there was one."""
        return self.alive and "frame" not in self._problems

    @property
    def problems(self) -> list[str]:
        """What is not as it should be, in sentences without secrets."""
        waiting = [
            f"events wait to be sent: {one.problem}" for one in self._couriers if one.problem
        ]
        return [
            shown(sentence)
            for sentence in (*self._problems.values(), self.log.problem, *waiting)
            if sentence
        ]

    @property
    def left_out(self) -> LeftOut:
        """How many boxes were left out, and why."""
        if self._tracker is None:
            return LeftOut()
        return self._tracker.left_out

    def latency(self) -> tuple[float, float]:
        """Median and 99 % of the seconds from a picture's arrival to its events on disk; NaN where
        there was none.
        """
        held = list(self._latency)
        if held:
            return (float(np.median(held)), float(np.quantile(held, 0.99)))
        return (np.nan, np.nan)

    def picture(self, after: int = 0, patience: float = 0.0) -> tuple[int, Image | None]:
        """The newest drawn picture and the number of its frame; one behind ``after`` where it comes
        in ``patience`` seconds.

        Pictures are drawn while somebody asks for them.
        """
        with self._fresh:
            self._asked = time.monotonic()
            self._fresh.wait_for(lambda: self._drawn[0] > after or self._stopped.is_set(), patience)
            return self._drawn

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                self._reload()
                frame = self.source.next(0.25)
                if frame is not None:
                    self._take(frame)
                    self._problems.pop("frame", None)
            except Exception as error:
                # A camera that runs for months is not ended by one picture, or by a full disk.
                self._problems["frame"] = str(error) or type(error).__name__
                self._stopped.wait(_REST)

    def _reload(self) -> None:
        """Read places and settings again where their files have changed; tracks and counts go on.

        What cannot be used changes nothing, and is said.
        """
        for what, path, use in (
            ("places", self.settings.places, self._places),
            ("settings", self.settings.config, self._settings),
        ):
            try:
                if path is None:
                    continue
                # The size too: times of files are coarse.
                changed = (path.stat().st_mtime_ns, path.stat().st_size)
                if changed == self._seen.get(what):
                    continue
                first = what not in self._seen
                now = time.monotonic()
                if self._changing.get(what, ((), 0.0))[0] != changed:
                    self._changing[what] = changed, now
                if not first and now < self._changing[what][1] + _SETTLED:
                    continue
                self._seen[what] = changed
                use(path, first)
                self._problems.pop(what, None)
            except FileNotFoundError:
                continue
            except Exception as error:
                self._problems[what] = (
                    f"the {what} stay as they were: {str(error) or type(error).__name__}"
                )

    def _places(self, path: Path, first: bool) -> None:
        before, state = self.watched
        watch = replace(before, places=read_places(path))
        self.watched = (watch, watch.carried(state, before))

    def _settings(self, path: Path, first: bool) -> None:
        """Go on with the tracks and other settings. Raises `InputError` for those that cannot
        change.
        """
        old = self._made
        tracker = self._tracker
        if first or old is None or tracker is None:
            return
        made = self._make(old.info)
        names = [
            name
            for name in sorted({*old.fixed, *made.fixed})
            if old.fixed.get(name) != made.fixed.get(name)
        ]
        if names:
            problem = f"{', '.join(names)} cannot change while it runs"
            raise InputError(problem, where=path, cure="End it and start it again.")
        going_on = Tracker(stages=made.kinds, fps=made.info.fps, seed=made.seed)
        going_on.warm_up()
        going_on.load_state_dict(tracker.state_dict(), same_settings=False)
        self._tracker = going_on
        self._made = made._replace(detector=old.detector)

    def _prepare(self, frame: LiveFrame, fps: float) -> tuple[Making, Tracker]:
        """What is made for the size of the first picture, and a tracker."""
        height, width = frame.image.shape[:2]
        made = self._make(SequenceInfo(width, height, round(max(fps, 1.0), 1), 0, self.name))
        tracker = Tracker(stages=made.kinds, fps=made.info.fps, seed=made.seed)
        names = self.watched[0].names
        tracker.warm_up()
        first = self.log.highest("group") + 1
        if made.groups is None:
            self._groups = None
        else:
            self._groups = OnlineGroups(made.groups, made.kinds.usual, first)
        self._annotate = Annotator(made.info, names=names or None, blur=self.settings.blur)
        self.maps = Maps.of(width, height)
        return made, tracker

    def _take(self, frame: LiveFrame) -> None:
        """One picture through detector, tracker and watch, into all files."""
        if self._made is None or self._tracker is None:
            status = self.source.status()
            self._begun = self._begun or time.monotonic()
            if status.frames < _MEASURED and time.monotonic() - self._begun < _MEASURING:
                return
            try:
                self._made, self._tracker = self._prepare(frame, status.fps)
                self._go_on(frame)
            except Exception:
                # The next picture begins anew: a half of it would be saved as all there is.
                self._made = self._tracker = None
                raise
        frame = frame._replace(
            number=frame.number + self._ahead[0], time=frame.time + self._ahead[1]
        )
        found = self._made.detector(Frame(frame.number, frame.time, frame.image))
        rows = self._tracker.update(found, frame.number, frame.time)
        step = self._tracker.step
        assert step is not None
        if self._groups is None:
            mixture = None
        else:
            mixture = self._groups.mixture(self._tracker.state.intensity, step)
        self._held.append(_Held(frame, step, mixture))
        self.frames = self.frames + 1
        self._last = (frame.number, frame.time, frame.wall)
        if len(self._held) > self._made.delay:
            held = self._held.popleft()
            with self._files:
                # When it was stopped while it hung, its files are complete already.
                if self._open:
                    self._finish(held, rows)
        # A checkpoint with events that are not written would lose them.
        due = self.settings.checkpoint and time.monotonic() >= self._due and not self._unwritten
        if due and not self._saving.is_alive():
            self._due = time.monotonic() + self.settings.checkpoint
            self._saving = threading.Thread(
                target=self._saver(ended=False),
                name=f"phdtrack {self.name} checkpoint",
                daemon=True,
            )
            self._saving.start()

    def _saver(self, *, ended: bool) -> Callable[[], None]:
        """What writes all that is known now, later and in any thread."""
        made = self._made
        tracker = self._tracker
        maps = self.maps
        watch, state = self.watched
        assert made is not None
        assert tracker is not None
        assert maps is not None
        held = tuple(
            HeldFrame(f.number, f.time, f.wall, step.detections.xyxy) for f, step, _ in self._held
        )
        pictures = (maps.people.copy(), maps.clutter.copy(), maps.time)
        minutes = np.array(self.minutes).reshape(-1, 4)
        seen = SavedCamera(*self._last, watch.places, state, held, *pictures, minutes)
        what = (
            key_of(made.fixed, made.info.width, made.info.height),
            tracker.snapshot(),
            seen,
            tracker.highest,
        )

        def write() -> None:
            try:
                save(self.settings.folder, *what, ended=ended)
                self._problems.pop("checkpoint", None)
            except Exception as error:
                self._problems["checkpoint"] = f"there is no newer checkpoint: {error}"

        return write

    def _go_on(self, frame: LiveFrame) -> None:
        """Take up what the run before has saved. What cannot be used is said; its identities are
        not given again.
        """
        made = self._made
        tracker = self._tracker
        maps = self.maps
        watch, _ = self.watched
        assert made is not None
        assert tracker is not None
        assert maps is not None
        if not self.settings.checkpoint:
            return
        highest = self.log.highest() + LOST
        try:
            found = load(
                self.settings.folder, key_of(made.fixed, made.info.width, made.info.height)
            )
            if found is None:
                self.log.forget_watched()
                tracker.skip_identities(highest if highest > LOST else 0)
                return
            highest, ended, packed, seen = max(found[0], highest), *found[1:]
            if isinstance(seen, InputError):
                raise seen
            if seen.people.shape != maps.people.shape:
                raise InputError("its maps are of another picture")
            # What came after the checkpoint, where it was killed: up to the last event, and up to
            # the last row.
            number, content = self.log.watched() or (0, b"")
            later = number >= (seen.held[0].number if seen.held else seen.number + 1)
            if later:
                known = SavedWatch.read(content, self.settings.folder)
            else:
                known = SavedWatch(seen.places, seen.watch)
            last = max(number, self._rows.last_frame())
            # A run that was killed before its first checkpoint may have come after one that ended
            # in order.
            ended = ended and last <= seen.number
            tracker.load_state_dict(packed, same_settings=False)
        except InputError as error:
            self._problems["checkpoint"] = (
                f"the checkpoint cannot be used, tracks and counts begin anew: {error}"
            )
            # The next checkpoint takes this sentence away: not at once.
            self._due = time.monotonic() + self.settings.checkpoint
            self.log.forget_watched()
            tracker.skip_identities(highest)
            return
        if not ended:
            tracker.skip_identities(highest - tracker.highest)
        interval = max(frame.wall - seen.wall, 1 / made.info.fps)
        self._ahead = (max(seen.number, last) + 1 - frame.number, seen.time + interval - frame.time)
        self.watched = (watch, watch.carried(known.state, replace(watch, places=known.places)))
        self.maps = Maps(seen.people, seen.clutter, maps.cell, seen.mapped)
        self.minutes.extend(
            Minute(wall, mean, int(most), int(count))
            for wall, mean, most, count in seen.minutes.tolist()
        )
        nothing = UpdateInfo(0.0, 0.0, 0.0, np.zeros(0), np.zeros(0))
        for one in (held for held in seen.held if held.number > last):
            step = Step(
                one.number,
                one.time,
                Detections.of(one.xyxy),
                nothing,
                Estimates.empty(0),
                Tracks.empty(),
            )
            self._held.append(
                _Held(
                    LiveFrame(one.number, one.time, one.wall, np.zeros((0, 0, 3), np.uint8)),
                    step,
                    None,
                )
            )

    def _finish(self, held: _Held, rows: Tracks) -> None:
        """A frame whose rows are final: events, files, counts, maps, picture."""
        frame = held.frame
        step = held.step
        watch, state = self.watched
        state, events = watch.advance(state, rows, frame.number, frame.time)
        self.watched = (watch, state)
        confirmed = rows.select(rows.confirmed)
        if self._groups is not None and held.mixture is not None:
            found = self._groups.events(held.mixture, confirmed, frame.number, frame.time)
            events = (
                *events,
                *(Event.of_group(one, k) for k, one in enumerate(found, len(events))),
            )
        self._finished = frame.number
        self._tell(events, frame.wall)
        self._rows.write(rows, frame.wall)
        self._latency.append(max(0.0, time.time() - frame.wall))
        probability = step.info.clutter_probability
        if len(probability) == len(step.detections):
            known = probability
        else:
            known = np.zeros(len(step.detections))
        assert self.maps is not None
        self.maps.add(frame.time, feet(confirmed.xyxy), step.detections.xyxy, known)
        self.tracks = len(confirmed)
        Minute.add(self.minutes, len(confirmed), frame.wall)
        if not frame.image.size:
            # It was seen by the run before.
            return
        recorded = self._video is not None and self._video.due(frame.wall)
        if not recorded and time.monotonic() - self._asked > _WATCHED:
            return
        picture = self._annotate(
            frame.image,
            frame.number,
            rows,
            step.detections,
            mass=step.info.mass,
            clutter_probability=probability,
        )
        with self._fresh:
            boxes = np.vstack([rows.xyxy, step.detections.xyxy])
            self._drawn = (frame.number, picture)
            self.ground = pixelated(frame.image, boxes, self.settings.blur)
            self._fresh.notify_all()
        if recorded and self._video is not None:
            self._video.write(picture, frame.wall)

    def _tell(self, events: Sequence[Event], wall: float = 0.0, *, last: bool = False) -> None:
        """Events of a frame to the log, and word of them to everybody; those that could not be
        written come first the next time, or now, where that is the ``last`` one."""
        watch, state = self.watched
        self._unwritten.extend(one.as_dict(self.name, stamp(wall), watch.names) for one in events)
        if not (self._unwritten or self.log.problem) or (
            time.monotonic() < self._patient and not last
        ):
            return
        # Not with each picture: another process that holds the table keeps this one waiting.
        self._patient = time.monotonic() + _AGAIN
        try:
            if self.settings.checkpoint:
                saved = (self._finished, SavedWatch(watch.places, state).content())
            else:
                saved = None
            fresh = self.log.write(self._unwritten, saved)
        except Exception as error:
            self._problems["events"] = (
                f"events are still to be written, the last {_UNWRITTEN} are kept: {error}"
            )
            return
        self._problems.pop("events", None)
        if self.log.problem:
            self._patient = self._patient
        else:
            self._patient = 0.0
        for event in fresh:
            self.counted[str(event["kind"])] += 1
            self.recent.append(event)
            self._send(event)
        self._unwritten.clear()
        for courier in self._couriers:
            courier.wake()
