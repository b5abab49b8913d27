"""The live page: pictures, counts, maps, states and events of all cameras, and lines and zones that
are drawn on the picture.

`web.guard` decides who may use it. No answer contains the address of a camera.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from phdtrack.addresses import shown
from phdtrack.errors import InputError
from phdtrack.live.engine import UNHEALTHY, Camera
from phdtrack.live.zones import places_of, write_places
from phdtrack.opencv_package import cv2
from phdtrack.web.endpoints import Endpoint, endpoint, static
from phdtrack.web.guard import HEALTH

STATIC = Path(__file__).parent / "static"
# Limits of saved places: bytes, places, corners of all together. Events that are shown.
MAX_BODY = 65536
MAX_PLACES = 50
MAX_CORNERS = 400
_EVENTS = 60
# Seconds that a request waits for a new picture; the width of maps.
_PATIENCE = 2.0
_MAP_WIDTH = 480
Row = tuple[Mapping[str, str], float]
METRICS = {
    "source_up": "1 while pictures arrive.",
    "source_fps": "Pictures a second that the camera sends.",
    "source_connects_total": "Connections that delivered pictures.",
    "source_frames_total": "Pictures that arrived.",
    "source_dropped_total": "Pictures that newer ones replaced.",
    "source_undecodable_total": "Packets without a picture.",
    "frames_total": "Pictures that were tracked.",
    "tracks": "Confirmed tracks in the newest picture.",
    "problems": "Number of current problems.",
    "boxes_left_out_total": "Detections that were not used.",
    "latency_seconds": "From a picture's arrival to its events on disk.",
    "events_total": "Events.",
    "place_entered_total": "Crossings inwards, or entries.",
    "place_left_total": "Crossings outwards, or exits.",
}


@dataclass(frozen=True, slots=True)
class Page:
    """The content of the page; ``cameras`` by name."""

    cameras: Mapping[str, Camera]

    def overview(self) -> list[dict[str, object]]:
        """Name, state and number of tracks of each camera."""
        return [
            {"name": one.name, "state": _state(one), "tracks": one.tracks}
            for one in self.cameras.values()
        ]

    def camera(self, name: str) -> dict[str, object]:
        """Everything about one camera except pictures."""
        one = self.cameras[name]
        watch, state = one.watched
        status = asdict(one.source.status())
        median, most = one.latency()
        places = [
            {
                "name": place.name,
                "kind": "zone" if place.closed else "line",
                "points": place.points,
                "anchor": place.anchor,
                "classes": place.classes,
                "entered": count.entered,
                "left": count.left,
            }
            for place, count in zip(watch.places, state.counts, strict=True)
        ]
        return {
            **status,
            "name": name,
            "state": _state(one),
            "problem": shown(str(status["problem"])),
            "problems": one.problems,
            "tracks": one.tracks,
            "latency": [median, most],
            "boxes_left_out": one.left_out._asdict(),
            "places": places,
            "drawable": one.settings.places is not None,
            "blur": one.settings.blur,
            "reports": one.settings.reports,
            "events": list(one.recent)[-_EVENTS:][::-1],
        }

    def minutes(self, name: str) -> list[object]:
        """Beginning, mean and largest number of tracks of each minute."""
        return list(self.cameras[name].minutes)

    def picture(self, name: str, after: int) -> tuple[int, bytes]:
        """Number and annotated picture (JPEG) of the newest frame, empty if there is none. Waits
        for a frame ``after`` that number.
        """
        number, image = self.cameras[name].picture(after, _PATIENCE)
        return number, (
            b""
            if image is None
            else cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        )

    def map(self, name: str, what: str) -> bytes:
        """Map of people, or of false alarms, over the darkened picture, as JPEG."""
        one = self.cameras[name]
        image = one.ground
        status = one.source.status()
        size = (_MAP_WIDTH, max(1, round(_MAP_WIDTH * (status.height or 9) / (status.width or 16))))
        ground = np.full((size[1], size[0], 3), 40, np.uint8)
        if image is not None:
            grey = cv2.cvtColor(
                cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY
            )
            ground = np.repeat(grey[..., None] // 2, 3, axis=2)
        if one.running is not None:
            maps = one.running.maps
            grid = {"people": maps.people, "clutter": maps.clutter}[what]
            # The square root keeps a place visible that is a quarter as busy as the busiest.
            share = np.sqrt(grid / (grid.max() or 1.0))
            share = np.clip(cv2.resize(share, size, interpolation=cv2.INTER_LINEAR), 0, 1)[
                ..., None
            ]
            colour = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_INFERNO)
            ground = (ground * (1 - share) + colour * share).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", ground, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])

    def save(self, name: str, sent: bytes) -> dict[str, object]:
        """Write lines and zones into the camera's file, which it reads with the next picture.

        Raises `InputError` if they cannot be used, or the camera has no such file; nothing changes
        then.
        """
        where = "what was sent"
        file = self.cameras[name].settings.places
        if file is None:
            raise InputError(
                "this camera has no file of lines and zones", cure="Start it with --places FILE."
            )
        if len(sent) > MAX_BODY:
            raise InputError(f"expected at most {MAX_BODY} bytes, got {len(sent)}", where=where)
        try:
            tables = json.loads(sent)
        except (ValueError, RecursionError):
            raise InputError("expected JSON", where=where) from None
        if not isinstance(tables, dict):
            raise InputError("expected an object with line and zone", where=where)
        lists = [one for one in tables.values() if isinstance(one, list)]
        points = [row.get("points") for one in lists for row in one if isinstance(row, dict)]
        corners = sum(len(each) for each in points if isinstance(each, list))
        if sum(map(len, lists)) > MAX_PLACES or corners > MAX_CORNERS:
            problem = (
                f"expected at most {MAX_PLACES} lines and zones, of {MAX_CORNERS} corners together"
            )
            raise InputError(problem, where=where)
        try:
            places = places_of(tables, where)
        except OverflowError:
            raise InputError("expected numbers of pixels", where=where) from None
        write_places(file, places)
        return {"saved": len(places)}

    def metrics(self) -> str:
        """All numbers in the text format of Prometheus."""
        found: dict[str, list[Row]] = {name: [] for name in METRICS}
        for name, one in self.cameras.items():
            status = one.source.status()
            watch, state = one.watched
            camera = {"camera": name}
            plain = (
                status.state == "live",
                status.fps,
                status.connects,
                status.frames,
                status.dropped,
                status.undecodable,
            )
            for metric, value in zip(
                METRICS, (*plain, one.frames, one.tracks, len(one.problems)), strict=False
            ):
                found[metric].append((camera, value))
            for reason, boxes in one.left_out._asdict().items():
                found["boxes_left_out_total"].append((camera | {"reason": reason}, boxes))
            for quantile, seconds in zip(("0.5", "0.99"), one.latency(), strict=True):
                found["latency_seconds"].append((camera | {"quantile": quantile}, seconds))
            for kind, count in sorted(one.counted.items()):
                found["events_total"].append((camera | {"kind": kind}, count))
            for place, counts in zip(watch.places, state.counts, strict=True):
                found["place_entered_total"].append(
                    (camera | {"place": place.name}, counts.entered)
                )
                found["place_left_total"].append((camera | {"place": place.name}, counts.left))
        lines = list[str]()
        for name, rows in found.items():
            kind = "counter" if name.endswith("_total") else "gauge"
            lines += [f"# HELP phdtrack_{name} {METRICS[name]}", f"# TYPE phdtrack_{name} {kind}"]
            for labels, value in rows:
                inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
                lines.append(
                    f"phdtrack_{name}{{{inside}}}"
                    f" {'NaN' if np.isnan(value) else format(float(value), '.10g')}"
                )
        return "\n".join(lines) + "\n"


def live_app(cameras: Sequence[Camera], patience: float = UNHEALTHY) -> Starlette:
    """The application, without `web.guard`. A camera without a picture, or without a tracked
    one, for more than ``patience`` seconds is not healthy.
    """
    page = Page({one.name: one for one in cameras})

    async def picture(request: Request) -> Response:
        after = request.query_params.get("after", "0")
        if after.isascii() and after.isdecimal() and len(after) < 16:
            wanted = int(after)
        else:
            wanted = 0
        number, data = await run_in_threadpool(page.picture, request.path_params["name"], wanted)
        headers = {"X-Frame": str(number)}
        if data:
            return Response(data, 200, headers, "image/jpeg")
        return Response(status_code=204, headers=headers)

    async def health(request: Request) -> Response:
        ill = [f"{one.name} {why}\n" for one in cameras if (why := _illness(one, patience))]
        return PlainTextResponse("".join(ill) or "ok\n", 503 if ill else 200)

    def known(answer: Endpoint) -> Endpoint:
        """The answer for known cameras and maps; 404 for others."""

        async def checked(request: Request) -> Response:
            given = request.path_params
            if given["name"] not in page.cameras or given.get("what", "people") not in (
                "people",
                "clutter",
            ):
                return PlainTextResponse("there is no such camera\n", 404)
            return await answer(request)

        return checked

    return Starlette(
        routes=[
            Route("/", endpoint((STATIC / "live.html").read_bytes, "text/html")),
            Route("/metrics", endpoint(page.metrics, "text/plain; version=0.0.4")),
            Route(HEALTH, health),
            Route("/api/cameras", endpoint(page.overview)),
            Route("/api/camera/{name:str}", known(endpoint(page.camera))),
            Route("/api/camera/{name:str}/minutes", known(endpoint(page.minutes))),
            Route("/api/camera/{name:str}/places", known(endpoint(page.save)), methods=["POST"]),
            Route("/picture/{name:str}.jpg", known(picture)),
            Route("/map/{name:str}/{what:str}.jpg", known(endpoint(page.map, "image/jpeg"))),
            *static(STATIC),
        ]
    )


def _illness(one: Camera, patience: float) -> str:
    """Why a camera is not healthy; empty if it is."""
    if not one.working:
        return "not working"
    status = one.source.status()
    if status.state != "live" and status.since > patience:
        return f"without a picture for {status.since:.0f} s, more than {patience:g} s"
    # A camera that sends few pictures is not ill between two of them.
    allowed = max(patience, 1.0, 3 / status.fps if status.fps else 0.0)
    if one.untracked > allowed:
        return f"without a tracked picture for {one.untracked:.0f} s, more than {allowed:g} s"
    return ""


def _state(one: Camera) -> str:
    """The source's state, or ``ended`` if its thread has ended."""
    if one.alive:
        return one.source.status().state
    return "ended"


def _escaped(text: str) -> str:
    """The value of a label."""
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
