"""The files of groups, written frame by frame: groups.csv, members.csv, events.csv, warnings.csv.

Contours are polygons in WKT (``MULTIPOLYGON``), on the ground in metres and, where there is a camera, in pixels of the
image. Rings that run clockwise on the ground are holes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Self

import cv2
import numpy as np

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.formats.write import Lines
from phdtrack.groups import polygon_area
from phdtrack.groups.pipeline import GroupFrame
from phdtrack.protocols import Camera
from phdtrack.types import F8

_EMPTY = "MULTIPOLYGON EMPTY"


class GroupFiles:
    """The four files; an `InputError` where one cannot be written. ``camera`` None: no contours in pixels."""

    def __init__(self, directory: RunDirectory, camera: Camera | None) -> None:
        self._camera = camera
        with ExitStack() as files:
            self._groups, self._members, self._events, self._warnings = (
                files.enter_context(Lines(directory.file(name)))
                for name in (rundir.GROUPS, rundir.MEMBERS, rundir.EVENTS, rundir.WARNINGS)
            )
            self._groups.write("frame,time,group,count,deviation,x,y,vx,vy,contours,contours_image")
            self._members.write("frame,group,member")
            self._events.write("frame,time,event,group,other")
            self._warnings.write("frame,time,first,second,seconds,distance,deviation,x,y,probability")
            self._open = files.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def write(self, frame: GroupFrame) -> None:
        """One frame; everything reaches the operating system."""
        n, at = frame.number, f"{frame.time:.6f}"
        groups, rows = frame.groups, list[str]()
        for g in range(len(frame)):
            numbers = [groups.count[g], groups.deviation[g], *groups.mean[:, g]]
            told = ",".join(f"{value:.7g}" for value in numbers)
            world, image = polygons(frame.contours[g]), self._image(frame.contours[g])
            rows.append(f'{n},{at},{frame.identity[g]},{told},"{world}","{image}"')
        _write(self._groups, rows)
        order = np.lexsort((frame.member, frame.membership))
        _write(self._members, [f"{n},{frame.membership[i]},{frame.member[i]}" for i in order])
        _write(self._events, [f"{e.frame},{e.time:.6f},{e.kind},{e.group},{e.other}" for e in frame.events])
        _write(
            self._warnings,
            [
                f"{n},{at},{w.first},{w.second},{w.seconds:.4g},{w.distance:.4g},{w.deviation:.4g},"
                f"{w.place[0]:.7g},{w.place[1]:.7g},{w.probability:.4g}"
                for w in frame.warnings
            ],
        )

    def _image(self, rings: Sequence[F8]) -> str:
        if self._camera is None:
            return _EMPTY
        return polygons(rings, [in_image(self._camera, ring) for ring in rings])


def _write(file: Lines, rows: list[str]) -> None:
    if rows:
        file.write("\n".join(rows))


def in_image(camera: Camera, ring: F8) -> F8:
    """(2, K) the ring (2, K) of ground points in pixels, closed, without the points that no pixel shows; (2, 0) where fewer
    than three are left."""
    pixel = camera.pixels(ring)
    seen = pixel[:, np.isfinite(pixel).all(axis=0)]
    if seen.shape[1] < 3:
        return np.zeros((2, 0))
    return seen if np.array_equal(seen[:, 0], seen[:, -1]) else np.hstack([seen, seen[:, :1]])


def polygons(rings: Sequence[F8], drawn: Sequence[F8] | None = None) -> str:
    """WKT of closed rings (2, K), the first point last; clockwise ones are holes of the ring around them.

    ``drawn`` are the rings as they are to be written, in another plane, where they may run the other way round.
    """
    drawn = rings if drawn is None else drawn
    outer = [k for k, ring in enumerate(rings) if polygon_area(ring) > 0 and drawn[k].shape[1]]
    parts = {k: [_ring(drawn[k])] for k in outer}
    for k, ring in enumerate(rings):
        if polygon_area(ring) <= 0 and drawn[k].shape[1]:
            around = next((o for o in outer if _inside(ring[:, 0], rings[o])), None)
            if around is not None:
                parts[around].append(_ring(drawn[k]))
    if not parts:
        return _EMPTY
    return "MULTIPOLYGON (" + ", ".join("(" + ", ".join(part) + ")" for part in parts.values()) + ")"


def _ring(ring: F8) -> str:
    return "(" + ", ".join(f"{x:.6g} {y:.6g}" for x, y in ring.T) + ")"


def _inside(point: F8, ring: F8) -> bool:
    outline = np.ascontiguousarray(ring.T.astype(np.float32))[:, None]
    return bool(cv2.pointPolygonTest(outline, (float(point[0]), float(point[1])), False) >= 0)
