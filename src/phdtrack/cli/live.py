"""``phdtrack live``: cameras without end, with events, rolling files and a page, until a signal
ends it.

A signal is the usual end: the files are completed within two seconds, and the exit status is 0. It
is 1 if a file could not be completed.
"""

from __future__ import annotations

import math
import queue
import re
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from phdtrack.addresses import filled, named, resolved, shown
from phdtrack.cli import options as given
from phdtrack.cli import signals
from phdtrack.cli.options import PageOptions, option, size
from phdtrack.cli.output import Output, counted, json_text
from phdtrack.config import Settings
from phdtrack.detect.base import class_names
from phdtrack.detect.moving_regions import reported_kind
from phdtrack.errors import InputError
from phdtrack.live.camera_setup import CameraSetup
from phdtrack.live.checkpoint import EVERY
from phdtrack.live.delivery import Courier, Mqtt, Send, Webhook, receivers
from phdtrack.live.engine import UNHEALTHY, Camera, CameraSettings
from phdtrack.live.events import Watch
from phdtrack.live.home_assistant import HomeAssistant
from phdtrack.live.outputs import stamp
from phdtrack.live.zones import read_places
from phdtrack.run import directory as rundir
from phdtrack.run.choices import scene_settings, unused_options
from phdtrack.run.requests import DEFAULT_DETECTOR, TrackingRequest, refuse
from phdtrack.run.window import Window, check_windows
from phdtrack.video.live_sources import LiveSource, SourceStatus, check_address

Names = Mapping[int, str] | None
# Seconds that all cameras may take to end; lines that may wait for a slow reader.
_ENDING = 1.5
_LINES = 10_000
# Seconds between two looks at what is to be printed, and at what is to be shown in windows.
_PRINTED_EVERY = 0.2
_SHOWN_EVERY = 0.03
_PLACES = (
    "Lines and zones, read again when they change; NAME=FILE: of one camera. Default: places.toml"
    " in the folder of each."
)
_QUOTA = (
    "Keep at most so much of the rows, and of the videos, of each camera, as 20GB. Default: all."
)
_UNHEALTHY = (
    "Seconds without a picture of a camera, or without a tracked one, after which /healthz answers"
    " 503."
)
_HOME_ASSISTANT = (
    "Announce cameras, lines and zones to Home Assistant through the broker of --mqtt."
)
_SNAPSHOTS = "Keep pictures (JPEG) of the last N events at lines and zones of each camera; 0: none."
_SAVED = "Seconds between checkpoints, from which a restart continues; 0: none."
_SOURCES = (
    "An address (rtsp:// or http://), the number of a camera, or a video. NAME=ADDRESS names it."
)


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options of outputs. Empty text, 0 and None stand for options without a value."""

    places: Annotated[list[str] | None, option("FILE", _PLACES)] = None
    webhook: Annotated[
        list[str] | None, option("URL", "Post each event to this address. Repeatable.")
    ] = None
    allow_private: Annotated[
        bool, typer.Option("--allow-private", help="A --webhook may be in a private network.")
    ] = False
    mqtt: Annotated[
        str, option("URL", "Publish each event: mqtt://[user:password@]host[:port]/topic.")
    ] = ""
    home_assistant: Annotated[bool, typer.Option("--home-assistant", help=_HOME_ASSISTANT)] = False
    video: Annotated[
        float,
        option("FPS", "Frames per second of the annotated videos; 0: none.", min=0.0, max=60.0),
    ] = 5.0
    snapshots: Annotated[int, option("N", _SNAPSHOTS, min=0, max=100_000)] = 0
    quota: Annotated[
        str, option("SIZE", _QUOTA, callback=lambda text: text if size(text) else "")
    ] = ""
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Write rows as Parquet, not as CSV.")
    ] = False
    blur: given.Blur = ""
    checkpoint_every: Annotated[float, option("S", _SAVED, min=0.0)] = EVERY
    unhealthy_after: Annotated[float, option("S", _UNHEALTHY, min=0.0)] = UNHEALTHY
    dwell: given.Dwell = 60.0
    leave_after: given.LeaveAfter = 3.0


def live(
    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help=_SOURCES)],
    options: TrackingRequest,
    write: LiveOptions,
    at: PageOptions,
    output: Output,
    out: Annotated[
        Path, option("DIR", "Directory to write into, with a folder for each camera.")
    ] = Path("live"),
    detector: given.Detector = DEFAULT_DETECTOR,
    max_width: given.MaxWidth = None,
    mask: given.Mask = None,
    scene: given.SceneFile = None,
    learn: given.Learn = True,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Serve the page, or not.")] = True,
    display: given.Display = False,
    duration: Annotated[
        float, option("S", "End after so many seconds. Default: at Ctrl-C.", min=0.0)
    ] = 0.0,
) -> None:
    """Track cameras without end: events, rows and videos by the hour, and a page with pictures,
    counts and maps.

    Connections that fail are retried. Changed files of settings and places are read again, and
    tracks go on. Ctrl-C, SIGTERM and SIGHUP end it with complete files and exit status 0. With
    --json stdout has a line for each event and for each change of a source's state.
    """
    scoring = {"--truth": options.truth, "--labelled": options.labelled}
    refuse(scoring, "a camera has no annotated truth", "phdtrack live")
    make = CameraSetup(options, tuple(scene_settings(scene)), detector, max_width, mask, learn)
    settings = make.settings()
    addresses = _usable_sources(sources, write, out)
    known = class_names(make.new_detector(settings, max_width or 0))
    output.warn(_doubts(make, settings, write))
    for url in write.webhook or []:
        Webhook(_with_secrets(url, "--webhook"))
    watchers = _Watchers(_home_assistant(write), _windows(addresses) if display else ())
    # Locked as long as it is held.
    directory = rundir.claim(out, False, {})
    server = _Server(at) if page else None
    # A slow reader misses lines, and finds them in the files.
    lines = queue.Queue[dict[str, object]](_LINES)

    def send(event: dict[str, object]) -> None:
        with suppress(queue.Full):
            lines.put_nowait(event)

    reports = reported_kind(detector)
    told = send if output.json else lambda event: None
    cameras = [
        Camera(
            name,
            LiveSource(address),
            make,
            replace(camera_settings(name, write, options.config, out, known), reports=reports),
            told,
        )
        for name, address in addresses.items()
    ]
    try:
        for one in cameras:
            one.start([Courier(one.log, send, name) for name, send in _receivers(write)])
        if server is not None:
            server.start(cameras, output, write.unhealthy_after)
        if reports:
            output.say(reports)
        _attend(cameras, lines, output, time.monotonic() + (duration or math.inf), watchers)
    except KeyboardInterrupt:
        signals.last_chance("stopped; the files are being completed")
    finally:
        cut = _end(cameras)
        watchers.stop()
    _print(lines, output)
    for one in cameras:
        events = counted(one.counted.total(), "event")
        output.say(
            f"{one.name}: {counted(one.frames, 'frame')}, {events}: {directory.file(one.name)}"
        )
        for sentence in _told(one):
            output.say(f"{one.name}: {sentence}")
        output.warn([f"{one.name}: {sentence}" for sentence in one.left_out.sentences()])
    if cut:
        output.warn(
            [
                f"not all files of {', '.join(cut)} are complete: those end in .part, and the next"
                " run completes them"
            ]
        )
        raise typer.Exit(1)


def _doubts(make: CameraSetup, settings: Settings, write: LiveOptions) -> Iterator[str]:
    """Sentences about guesses, and about options that have no effect without another one."""
    looks = make.described_by(settings)
    yield from looks.guesses
    yield from unused_options(make.tracking, settings, described=looks.describer is not None)
    if write.allow_private and not write.webhook:
        yield "--allow-private has no effect without --webhook: leave it out"


def _told(camera: Camera) -> Iterator[str]:
    """Sentences about objects that came back, and boxes that the user's settings left out."""
    if camera.returned == 1:
        yield "1 object came back and got its identity again"
    elif camera.returned:
        yield f"{camera.returned} objects came back and got their identities again"
    if camera.left_out.unwanted:
        yield camera.left_out.as_asked


def named_sources(words: Sequence[str]) -> dict[str, str]:
    """Addresses by name. Raises `InputError` if two have one name, or a file does not exist."""
    found = dict[str, str]()
    for word in words:
        match = re.fullmatch(r"([A-Za-z0-9][A-Za-z0-9._-]*)=(.+)", word)
        name, address = match.groups() if match else ("", word)
        head, _, rest = word.partition("=")
        if not match and "://" in rest and not re.search("[:?{]", head):
            cure = "Use letters, digits, points, hyphens and underscores, as gate=rtsp://…."
            raise InputError(f"{head!r} is no name of a camera", where="SOURCE", cure=cure)
        check_address(address)
        name = name or named(address)
        place = resolved(address)
        if "://" not in place and not place.isdecimal() and not Path(place).is_file():
            cure = "Name rtsp://…, http://…, a camera's number or a video."
            raise InputError("there is no such file", where=address, cure=cure)
        if name in found:
            raise InputError(
                f"two sources are called {name}", where="SOURCE", cure="Say NAME=ADDRESS."
            )
        found[name] = address
    return found


def camera_settings(
    name: str, write: LiveOptions, config: Path | None, out: Path, names: Names = None
) -> CameraSettings:
    """The settings of the camera of this name."""
    return CameraSettings(
        folder=out / name,
        places=_places(write.places or [], name, out),
        config=config,
        watch=Watch(dwell=write.dwell, leave_after=write.leave_after, names=names or {}),
        video=write.video,
        quota=size(write.quota),
        parquet=write.parquet,
        blur=write.blur,
        checkpoint=write.checkpoint_every,
        snapshots=write.snapshots,
    )


def _places(given: Sequence[str], name: str, out: Path) -> Path:
    """The file of lines and zones of a camera."""
    own = [one.removeprefix(f"{name}=") for one in given if one.startswith(f"{name}=")]
    all_ = [one for one in given if not re.match(r"[A-Za-z0-9][A-Za-z0-9._-]*=", one)]
    if own or all_:
        return Path([*all_, *own][-1])
    return out / name / "places.toml"


def _usable_sources(words: Sequence[str], write: LiveOptions, out: Path) -> dict[str, str]:
    """Addresses by name, if they and their files of lines and zones can be used."""
    found = named_sources(words)
    check_places(write.places or [], found, out)
    return found


def check_places(given: Sequence[str], names: Iterable[str], out: Path) -> None:
    """Raise `InputError` if a file of lines and zones cannot be used, or one that is asked for does
    not exist. Later changes of it are forgiven: the places stay as they were.
    """
    for name in names:
        file = _places(given, name, out)
        usual = out / name / "places.toml"
        if file.exists():
            read_places(file)
        elif file != usual:
            cure = f"Write it, or leave --places out: the page saves what is drawn into {usual}."
            raise InputError("there is no such file of lines and zones", where=file, cure=cure)


def _receivers(write: LiveOptions) -> Iterator[tuple[str, Send]]:
    """The receivers of a camera's events, by name."""
    hooks = [_with_secrets(url, "--webhook") for url in write.webhook or []]
    brokers = [_with_secrets(write.mqtt, "--mqtt")] if write.mqtt else []
    names = receivers([*hooks, *brokers])
    yield from zip(
        names,
        [*(Webhook(url, write.allow_private) for url in hooks), *map(Mqtt, brokers)],
        strict=True,
    )


def _with_secrets(url: str, where: str) -> str:
    """The address with the passwords that it takes from the environment or from files. Raises
    `InputError` if there are none.
    """
    try:
        return filled(url)
    except LookupError as error:
        raise InputError(str(error), where=where) from None


class _Server:
    """The page, in a thread of its own. Raises `InputError` if a package is missing or the port is
    taken.
    """

    def __init__(self, at: PageOptions) -> None:
        from phdtrack.web.serving import listen

        self._address = listen(at.host, at.port, at.allow_host or (), at.certificate, at.key)

    def start(self, cameras: Sequence[Camera], output: Output, patience: float) -> None:
        """Serve the page from now on; ``patience`` as `live_app` has it."""
        from phdtrack.live.live_page import live_app
        from phdtrack.web.serving import serve

        threading.Thread(
            target=serve,
            args=(live_app(cameras, patience), self._address),
            name="phdtrack page",
            daemon=True,
        ).start()
        output.page(self._address.url)


def _home_assistant(write: LiveOptions) -> HomeAssistant | None:
    """Home Assistant behind the broker, if it is to know the cameras. Raises `InputError` without a
    broker.
    """
    if not write.home_assistant:
        return None
    if not write.mqtt:
        cure = "Say --mqtt mqtt://[user:password@]host[:port]/topic as well."
        raise InputError("no broker is given", where="--home-assistant", cure=cure)
    return HomeAssistant(_with_secrets(write.mqtt, "--mqtt"))


class _Watchers:
    """Home Assistant, if it is to know the cameras, and a window for each camera, or none."""

    def __init__(self, assistant: HomeAssistant | None, windows: Sequence[Window]) -> None:
        self._assistant = assistant
        self._windows = windows
        self._problem = ""
        self.pause = _SHOWN_EVERY if windows else _PRINTED_EVERY
        """Seconds between two updates."""

    def update(self, cameras: Sequence[Camera]) -> list[str]:
        """Tell them what is new; a sentence if that is no longer, or again, possible. Raises
        `KeyboardInterrupt` if Q is pressed in a window.
        """
        before = self._problem
        if self._assistant is not None:
            self._assistant.update(cameras, time.monotonic())
            self._problem = self._assistant.problem
        for k, window in enumerate(self._windows):
            image = cameras[k].picture()[1]
            # The same picture again if there is no other: the window needs attention meanwhile.
            if image is not None:
                window.show(image)
        if self._problem == before:
            return []
        return [f"Home Assistant: {self._problem or 'the broker is connected'}"]

    def stop(self) -> None:
        """Say that it has ended, and close the windows."""
        if self._assistant is not None:
            self._assistant.stop()
        for window in self._windows:
            window.close()


def _windows(names: Iterable[str]) -> list[Window]:
    """A window for each camera of these names. Raises `InputError` if there can be none."""
    check_windows()
    return [Window(f"phdtrack {name}") for name in names]


def _attend(
    cameras: Sequence[Camera],
    lines: queue.Queue[dict[str, object]],
    output: Output,
    end: float,
    watchers: _Watchers,
) -> None:
    """Print changes of the sources' states, and warnings, until the end; tell the watchers."""
    said = dict[str, tuple[str, ...]]()
    warned = dict[str, int]()
    while time.monotonic() < end:
        _warn(cameras, output, warned)
        for sentence in watchers.update(cameras):
            _log(output, sentence)
        for one in cameras:
            status = one.source.status()
            now = (*logged_state(status), *one.problems)
            if said.get(one.name) == now:
                continue
            said[one.name] = now
            if output.json:
                line: dict[str, object] = {
                    "width": status.width,
                    "height": status.height,
                    "fps": round(status.fps, 2),
                }
                line |= {
                    "kind": "source",
                    "time": stamp(time.time()),
                    "source": one.name,
                    "state": now[0],
                    "problem": now[1],
                    "problems": now[2:],
                }
                line |= {"boxes_left_out": one.left_out._asdict()}
                with suppress(queue.Full):
                    lines.put_nowait(line)
            elif now[0] != "connecting" or now[1:] != ("",):
                _log(output, ": ".join(filter(None, (one.name, *now))))
        _print(lines, output, watchers.pause)


def _warn(cameras: Sequence[Camera], output: Output, said: dict[str, int]) -> None:
    """Print the warnings of cameras' trackers, each once; ``said`` counts those of each camera."""
    for one in cameras:
        newest = one.warnings[said.get(one.name, 0) :]
        said[one.name] = said.get(one.name, 0) + len(newest)
        for sentence in newest:
            _log(output, f"warning: {one.name}: {sentence}")


def logged_state(status: SourceStatus) -> tuple[str, str]:
    """The state of a source, and why it is down; what ended an earlier connection is over."""
    if status.state in ("live", "silent"):
        return status.state, ""
    if status.problem:
        # Attempts to connect again are not worth a line each.
        return "down", shown(status.problem)
    return status.state, ""


def _log(output: Output, sentence: str) -> None:
    """Print a line with its time. If stderr cannot be written, as on a full disk, the cameras go
    on.
    """
    with suppress(OSError):
        output.note(f"{stamp(time.time())} {sentence}")


def _print(lines: queue.Queue[dict[str, object]], output: Output, wait: float = 0.0) -> None:
    """Print all lines that are there; waits for the first."""
    with suppress(queue.Empty):
        if wait:
            line = lines.get(timeout=wait)
        else:
            line = lines.get_nowait()
        while output.json:
            print(json_text(line), flush=True)
            line = lines.get_nowait()


def _end(cameras: Sequence[Camera]) -> list[str]:
    """End all cameras, and give the names of those whose files are not complete."""
    end = time.monotonic() + _ENDING
    for one in cameras:
        one.ask_to_stop()
    return [one.name for one in cameras if not one.stop(max(0.1, end - time.monotonic()))]
