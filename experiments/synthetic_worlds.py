"""Simulated objects in front of a simulated camera: people, dancers, players, cars from a car, cars
from above, and cells.

Objects move on the ground (metres; cells: pixels), and a camera projects them to boxes. Imports
nothing of phdtrack: the environment of the peers has neither its dependencies nor itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F8 = npt.NDArray[np.float64]
I8 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]
Rng = np.random.Generator

# Motion is simulated at this rate or faster, so that it does not depend on the frame rate.
MIN_RATE = 10.0
# Kinds whose camera looks along the ground: near objects hide far ones.
ON_GROUND = ("pedestrian", "dancer", "player", "car")
# Seconds in which walkers and cars reach the speed that they want, and turn to where they want.
_WALK_RESPONSE = 0.4
_CAR_RESPONSE = 1.5
_GOAL_TIME = 3.0
# Seconds in which cars close a gap, and their length and distance, metres.
_HEADWAY = 1.2
_CAR = (4.5, 1.85, 1.5)
_GAP = 2.0
# Seconds of green and red of a traffic light.
_GREEN = (10.0, 25.0)
_LANE = 3.5
# Metres ahead within which cars are simulated, and at which a new one appears.
_ROAD = 90.0
_CAMERA_HEIGHT_OF_CAR = 1.5
# Memory of the shake of a camera, seconds.
_SHAKE = (0.05, 0.4)
# A box is in the truth if this share of it is in the frame and it is this high, pixels.
MIN_INSIDE = 0.3
MIN_HEIGHT = 8.0
# Objects of which less than this share is visible for longer than these seconds are not in the
# truth: annotators interpolate over short gaps only.
MIN_VISIBLE = 0.1
MAX_HIDDEN = 1.0
# A figure fills this share of the width of its box.
_SOLID = 0.8
_GRID = 7


@dataclass(frozen=True, slots=True)
class World:
    """The objects and the camera.

    Attributes
    ----------
    kind : pedestrian, dancer, player, car (seen from a car), aerial (cars from above) or cell.
    width, height : of the frame, pixels.
    fps, frames : rate in Hz, and number of frames.
    count : number of objects that are simulated at a time.
    speed : mean speed, metres a second (cells: own sizes a second).
    turn : deviation of the heading, rad per root second.
    standing, dwell : share of the time in which an object stands, and for how many seconds.
    size : height of an object in the middle of the scene, pixels (aerial: length of a car).
    spread : deviation of the logarithm of objects' sizes.
    change : how much arms and legs widen a box, as a share of its width.
    camera : fixed, pan, shake, or drive.
    camera_rate : pan: frame widths a second; shake: deviation in frame widths; drive: metres a
        second.
    obstacles : number of things that stand before all objects.
    """

    kind: str
    width: int
    height: int
    fps: float
    frames: int
    count: int
    speed: float
    turn: float
    standing: float
    dwell: float
    size: float
    spread: float
    change: float
    camera: str
    camera_rate: float
    obstacles: int


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Motion of N objects in T frames: ``place`` (T, N, 2), ``heading`` (T, N) rad, ``identity``
    (T, N): one that has left is followed by another.
    """

    place: F8
    heading: F8
    identity: I8


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """Boxes of N objects in T frames.

    Attributes
    ----------
    xyxy : (T, N, 4) pixels, not cut at the frame's borders.
    depth : (T, N) distance from the camera; smaller ones hide larger ones.
    identity : (T, N) from 1 on.
    shown : (T, N) True if the object is in the truth.
    visible : (T, N) share of the box in the frame that nothing hides.
    shift : (T, 2) motion of the picture of what stands far away, pixels.
    """

    xyxy: F8
    depth: F8
    identity: I8
    shown: Bool
    visible: F8
    shift: F8


def wandering(frames: int, n: int, memory: float, dt: float, rng: Rng) -> F8:
    """(frames, n) independent Gaussian processes with variance 1 and a time constant in seconds; 0:
    white noise.
    """
    noise = rng.normal(size=(frames, n))
    if memory <= 0:
        return noise
    keep = np.exp(-dt / memory)
    out = np.empty_like(noise)
    out[0] = noise[0]
    for k in range(1, frames):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * noise[k]
    return out


def gliding(frames: int, n: int, memory: float, dt: float, rng: Rng) -> F8:
    """(frames, n) Gaussian processes with variance 1 that have a velocity: what has mass, as a
    camera or an arm, does not jump. ``memory`` in seconds, above 0.
    """
    keep = np.exp(-dt / memory)
    # Long enough before the first frame for the start to be forgotten.
    before = int(np.ceil(8 * memory / dt))
    moved = wandering(before + frames, n, memory, dt, rng)
    out = np.empty((frames, n))
    state = moved[0]
    for k in range(before + frames):
        state = keep * state + (1 - keep) * moved[k]
        if k >= before:
            out[k - before] = state
    shares = 1 - keep**2
    return out / ((1 - keep) * np.sqrt(1 / shares + 2 * keep**2 / shares**2))


def figures(world: World, rng: Rng) -> Figures:
    """Simulate the objects, and project them."""
    paths_rng, camera_rng, shape_rng, obstacle_rng = rng.spawn(4)
    shift = camera_shift(world, camera_rng)
    if world.kind == "car":
        xyxy, depth, identity = _from_a_car(world, shift, paths_rng)
    elif world.kind == "aerial":
        xyxy, depth, identity = _from_above(world, shift, paths_rng)
    else:
        paths, region = _walking(world, shift, paths_rng)
        xyxy, depth, identity = _projected(world, paths, region, shift, shape_rng)
    inside = _inside(xyxy, world)
    high = xyxy[..., 3] - xyxy[..., 1] >= MIN_HEIGHT
    shown = (inside >= MIN_INSIDE) & high & (depth > 0)
    blocks = _obstacles(world, shift, obstacle_rng)
    visible = _visible(xyxy, depth, shown, blocks, world)
    shown &= annotated(visible, identity, MAX_HIDDEN * world.fps)
    return Figures(xyxy, depth, identity, shown, visible, shift)


def annotated(visible: F8, identity: I8, longest: float) -> Bool:
    """(T, N) True if an object is visible, or not for at most ``longest`` frames."""
    keep = visible >= MIN_VISIBLE
    for i in range(visible.shape[1]):
        hidden = ~keep[:, i]
        # A run ends where it becomes visible, and where another object follows.
        change = np.diff(hidden, prepend=False) | (np.diff(identity[:, i], prepend=0) != 0)
        run = np.cumsum(change)
        keep[:, i] |= np.bincount(run)[run] <= longest
    return keep


def camera_shift(world: World, rng: Rng) -> F8:
    """(T, 2) the motion of the picture by the camera, pixels."""
    t = np.arange(world.frames) / world.fps
    if world.camera == "pan":
        # It turns to and fro, and not in equal periods; the amplitude is half a frame.
        rate = world.camera_rate
        period = 2 * np.pi * 0.4 / rate
        phase = rng.uniform(0, 2 * np.pi) + 0.5 * gliding(world.frames, 1, 10.0, 1 / world.fps, rng)
        swing = 0.4 * world.width * np.sin(2 * np.pi * t / period + phase[:, 0])
        return np.column_stack([swing - swing.mean(), 0.1 * (swing - swing.mean())])
    if world.camera == "shake":
        memory = rng.uniform(*_SHAKE)
        moves = gliding(world.frames, 2, memory, 1 / world.fps, rng)
        return world.camera_rate * world.width * moves
    if world.camera == "drive":
        # Bends of the road and bumps.
        bends = gliding(world.frames, 1, 3.0, 1 / world.fps, rng)[:, 0]
        bumps = gliding(world.frames, 1, 0.2, 1 / world.fps, rng)[:, 0]
        return np.column_stack([0.08 * world.width * bends, 0.004 * world.height * bumps])
    return np.zeros((world.frames, 2))


@dataclass(frozen=True, slots=True)
class _Region:
    """The ground that is in the picture, from ``near`` to ``far``, or the picture (cells).

    ``half`` is half its width at distance 1 for people, else half its width. ``focal`` in pixels,
    ``above``: height of the camera, metres; ``horizon``: its row.
    """

    near: float
    far: float
    half: float
    fan: bool
    focal: float
    above: float
    horizon: float

    def reach(self, depth: F8) -> F8:
        """Half the width at these depths."""
        return self.half * depth if self.fan else np.full(depth.shape, self.half)


_STATURE = 1.72
# Above the ground, metres; width over height of the box.
_ASPECT = 0.4


def _region(world: World, margin: float) -> _Region:
    """The ground on which people move: a fan before the camera, a stage or a field."""
    w, h = world.width, world.height
    if world.kind == "cell":
        return _Region(0.0, float(h), w / 2 + margin, False, 1.0, 0.0, 0.0)
    focal = 1.1 * w
    middle = focal * _STATURE / world.size
    if world.kind == "pedestrian":
        near, far = middle / 2, middle * 2.2
        # The near end is at the lower border of the picture.
        above = max(1.5, 0.25 * near)
        horizon = h - focal * above / near
        return _Region(near, far, (w / 2 + margin) / focal, True, focal, above, horizon)
    deep = 0.2 if world.kind == "dancer" else 0.45
    near, far = middle * (1 - deep), middle * (1 + deep)
    above = 2.0 if world.kind == "dancer" else 0.35 * middle
    horizon = 0.85 * h - focal * above / near
    wide = 0.75 if world.kind == "dancer" else 1.0
    half = (wide * w / 2 + margin) / focal * middle
    return _Region(near, far, half, False, focal, above, horizon)


def _walking(world: World, shift: F8, rng: Rng) -> tuple[Paths, _Region]:
    """People, players, dancers and cells: each goes at its own pace, stops, and turns."""
    margin = float(np.abs(shift[:, 0]).max()) if world.camera == "pan" else 0.0
    region = _region(world, margin)
    n = round(world.count * (1 + 2 * margin / world.width))
    steps = max(1, int(np.ceil(MIN_RATE / world.fps)))
    walkers = _Walkers(world, region, n, 1 / (world.fps * steps), rng)
    place = np.empty((world.frames, n, 2))
    heading = np.empty((world.frames, n))
    identity = np.empty((world.frames, n), np.int64)
    for k in range(world.frames):
        place[k], heading[k], identity[k] = walkers.place, walkers.heading, walkers.identity
        for _ in range(steps):
            walkers.step()
    return Paths(place, heading, identity), region


class _Walkers:
    """The state of walking objects; ``place`` (n, 2): to the right, and away."""

    def __init__(self, world: World, region: _Region, n: int, h: float, rng: Rng) -> None:
        self.world = world
        self.region = region
        self.h = h
        self.rng = rng
        self.unit = world.size if world.kind == "cell" else 1.0
        depth = rng.uniform(region.near, region.far, n)
        self.place = np.column_stack([rng.uniform(-1, 1, n) * region.reach(depth), depth])
        self.goal = rng.uniform(0, 2 * np.pi, n)
        self.heading = self.goal.copy()
        self.wanted = self._paces(n)
        self.stands = rng.random(n) < world.standing
        self.pace = np.where(self.stands, 0.0, self.wanted)
        self.identity = np.arange(1, n + 1)
        self.next = n + 1

    def _paces(self, n: int) -> F8:
        """Speeds that objects want."""
        return self.world.speed * self.unit * np.exp(self.rng.normal(-0.03, 0.25, n))

    def step(self) -> None:
        """Move all by one time step."""
        world, h, rng = self.world, self.h, self.rng
        n = len(self.place)
        if world.standing > 0:
            # Standing lasts `dwell` seconds on average, and walking as long as gives the share.
            walk = world.dwell * (1 - world.standing) / max(world.standing, 1e-9)
            leave = np.where(self.stands, h / world.dwell, h / max(walk, 1e-9))
            self.stands ^= rng.random(n) < leave
        if world.kind == "player":
            # Runs of some seconds, each with its own direction and pace.
            new = rng.random(n) < h / 2.0
            self.goal[new] = rng.uniform(0, 2 * np.pi, int(new.sum()))
            self.wanted[new] = self._paces(int(new.sum())) * rng.uniform(0.3, 2.0, int(new.sum()))
        self.heading += world.turn * np.sqrt(h) * rng.normal(size=n)
        if world.kind in ("pedestrian", "player"):
            off = np.angle(np.exp(1j * (self.goal - self.heading)))
            self.heading += off * min(1.0, h / (_GOAL_TIME if world.kind == "pedestrian" else 0.5))
        target = np.where(self.stands, 0.0, self.wanted)
        self.pace += (target - self.pace) * min(1.0, h / _WALK_RESPONSE)
        way = np.column_stack([np.cos(self.heading), np.sin(self.heading)])
        self.place = self.place + h * self.pace[:, None] * way
        self._part()
        self._stay()

    def _part(self) -> None:
        """Objects do not stand in one place: those that touch push each other away."""
        room = 0.8 * self.unit if self.world.kind == "cell" else 0.5
        away = self.place[:, None] - self.place[None]
        far = np.hypot(away[..., 0], away[..., 1])
        near = (far < room) & (far > 0)
        push = np.where(near, (room - far) / np.maximum(far, 1e-6), 0.0)
        self.place = self.place + min(0.5, 2 * self.h) * (push[..., None] * away).sum(axis=1)

    def _stay(self) -> None:
        """Dancers and players turn at the border; others leave, and another comes."""
        region, kind = self.region, self.world.kind
        reach = region.reach(self.place[:, 1])
        # Objects are gone when they are out of the picture.
        room = self.unit if kind == "cell" else 0.5
        beside = np.abs(self.place[:, 0]) > reach + room
        beyond = (self.place[:, 1] < region.near - room) | (self.place[:, 1] > region.far + room)
        if kind in ("dancer", "player"):
            inward = np.arctan2(
                (region.near + region.far) / 2 - self.place[:, 1], -self.place[:, 0]
            )
            out = beside | beyond
            turned = inward + self.rng.normal(0, 0.5, len(out))
            self.goal[out] = turned[out]
            self.heading[out] = turned[out]
            return
        gone = np.flatnonzero(beside | beyond)
        if not len(gone):
            return
        n = len(gone)
        side = np.where(self.rng.random(n) < 0.5, -1.0, 1.0)
        depth = self.rng.uniform(region.near, region.far, n)
        x = side * (region.reach(depth) + 0.8 * room)
        self.place[gone] = np.column_stack([x, depth])
        self.goal[gone] = np.where(side < 0, 0.0, np.pi) + self.rng.normal(0, 0.4, n)
        self.heading[gone] = self.goal[gone]
        self.wanted[gone] = self._paces(n)
        self.stands[gone] = False
        self.pace[gone] = self.wanted[gone]
        self.identity[gone] = np.arange(self.next, self.next + n)
        self.next += n


def _projected(
    world: World, paths: Paths, region: _Region, shift: F8, rng: Rng
) -> tuple[F8, F8, I8]:
    """Boxes, depths and identities of walkers."""
    frames, n = paths.heading.shape
    tall = np.exp(world.spread * rng.normal(size=n))
    # Arms and legs: slow changes of the shape that only widen or lower a box.
    limbs = np.abs(gliding(frames, n, 0.4, 1 / world.fps, rng)) * world.change
    if world.kind == "cell":
        # Ellipses that turn slowly, seen from above.
        angle = np.cumsum(0.3 / np.sqrt(world.fps) * rng.normal(size=(frames, n)), axis=0)
        long = world.size * tall / 2 * (1 + 0.3 * limbs)
        short = long * rng.uniform(0.6, 1.0, n)
        half = np.stack(
            [
                np.hypot(long * np.cos(angle), short * np.sin(angle)),
                np.hypot(long * np.sin(angle), short * np.cos(angle)),
            ],
            axis=-1,
        )
        centre = paths.place + np.array([world.width / 2, 0.0]) + shift[:, None]
        depth = np.broadcast_to(1.0 + rng.random(n), (frames, n))
        return np.concatenate([centre - half, centre + half], axis=-1), depth, paths.identity
    depth = np.maximum(paths.place[..., 1], 0.3)
    scale = region.focal / depth
    foot = region.horizon + scale * region.above + shift[:, 1:]
    high = scale * _STATURE * tall * (1 - 0.25 * np.minimum(limbs, 1.0))
    wide = scale * _STATURE * tall * _ASPECT * (1 + limbs) / 2
    x = world.width / 2 + scale * paths.place[..., 0] + shift[:, :1]
    return np.stack([x - wide, foot - high, x + wide, foot], axis=-1), depth, paths.identity


def _from_a_car(world: World, shift: F8, rng: Rng) -> tuple[F8, F8, I8]:
    """Cars as a driving car sees them: parked ones, oncoming ones, and others that go its way."""
    road = _Road(world, rng)
    steps = max(1, int(np.ceil(MIN_RATE / world.fps)))
    boxes = np.empty((world.frames, world.count, 4))
    depth = np.empty((world.frames, world.count))
    identity = np.empty((world.frames, world.count), np.int64)
    focal = 0.9 * world.width
    length, wide, high = _CAR
    size = np.exp(world.spread * rng.normal(size=world.count))
    for k in range(world.frames):
        z = np.maximum(road.ahead, 1.5)
        side = np.arctan2(np.abs(road.beside), z)
        half = size * (wide * np.cos(side) + length * np.sin(side)) / 2 * focal / z
        x = world.width / 2 + focal * road.beside / z + shift[k, 0]
        foot = world.height * 0.48 + focal * _CAMERA_HEIGHT_OF_CAR / z + shift[k, 1]
        boxes[k] = np.column_stack([x - half, foot - size * high * focal / z, x + half, foot])
        depth[k] = np.where((road.ahead > 3) & (road.ahead < _ROAD), road.ahead, -1)
        identity[k] = road.identity
        for _ in range(steps):
            road.step(1 / (world.fps * steps))
    return boxes, depth, identity


class _Road:
    """The state of the cars around a driving car: ``ahead`` and ``beside``, metres."""

    def __init__(self, world: World, rng: Rng) -> None:
        n = world.count
        self.world = world
        self.rng = rng
        # 0: parked, 1: oncoming, 2: the same way.
        moving = rng.random(n) >= world.standing
        self.kind = np.where(moving, rng.integers(1, 3, n), 0)
        self.beside = np.choose(
            self.kind,
            [
                np.where(rng.random(n) < 0.6, 2.1, -3.1) * _LANE * 0.9,
                np.full(n, -_LANE),
                np.where(rng.random(n) < 0.6, 0.0, _LANE),
            ],
        )
        self.ahead = np.empty(n)
        for one in np.unique(self.beside):
            lane = np.flatnonzero(self.beside == one)
            gaps = rng.uniform(7, 2 * _ROAD / max(len(lane), 1) + 8, len(lane))
            self.ahead[lane] = 2 + np.cumsum(gaps)
        self.wanted = np.where(self.kind == 0, 0.0, world.speed * np.exp(rng.normal(0, 0.2, n)))
        self.pace = self.wanted.copy()
        self.own = world.camera_rate
        self.own_wanted = world.camera_rate
        self.identity = np.arange(1, n + 1)
        self.next = n + 1

    def step(self, h: float) -> None:
        """Drive on by ``h`` seconds."""
        if self.rng.random() < h / 8:
            # The road is free, or there is a reason to brake.
            self.own_wanted = self.world.camera_rate * self.rng.choice([0.0, 0.5, 1.0, 1.2])
        leaders = self.ahead[(self.beside == 0) & (self.ahead > 0)]
        limit = max(0.0, (leaders.min() - 8) / _HEADWAY) if len(leaders) else np.inf
        self.own += (min(self.own_wanted, limit) - self.own) * min(1.0, h / _CAR_RESPONSE)
        target = self.wanted.copy()
        for one in np.unique(self.beside[self.kind > 0]):
            lane = np.flatnonzero(self.beside == one)
            way = 1.0 if self.kind[lane[0]] == 2 else -1.0
            lane = lane[np.argsort(-way * self.ahead[lane])]
            gap = np.abs(np.diff(self.ahead[lane])) - _CAR[0] - _GAP
            target[lane[1:]] = np.minimum(target[lane[1:]], np.maximum(gap, 0) / _HEADWAY)
        self.pace += (target - self.pace) * min(1.0, h / _CAR_RESPONSE)
        way = np.choose(self.kind, [0.0, -1.0, 1.0])
        self.ahead = self.ahead + h * (way * self.pace - self.own)
        for gone in np.flatnonzero(self.ahead < 1.0):
            lane = self.beside == self.beside[gone]
            self.ahead[gone] = max(_ROAD, self.ahead[lane].max()) + self.rng.uniform(8, 30)
            self.identity[gone] = self.next
            self.next += 1


def _from_above(world: World, shift: F8, rng: Rng) -> tuple[F8, F8, I8]:
    """Cars on straight roads with a traffic light, and parked beside them, seen from above."""
    scale = world.size / _CAR[0]
    frames, n = world.frames, world.count
    centre = np.array([world.width, world.height]) / 2
    margin = float(np.abs(shift[:, 0]).max())
    reach = (np.hypot(*centre) + margin) / scale + 2 * _CAR[0]
    roads = int(rng.integers(1, 4))
    angles = rng.uniform(0, np.pi) + np.pi * np.arange(roads) / roads
    offsets = rng.uniform(-0.3, 0.3, roads) * min(world.width, world.height) / scale
    lane_of = rng.integers(0, 2 * roads, n)
    parked = rng.random(n) < world.standing
    traffic = _Traffic(world, lane_of, parked, reach, rng)
    # Parked cars stand beside a road.
    side = np.where(lane_of % 2 == 0, 1.0, -1.0)
    across = offsets[lane_of // 2] + side * np.where(parked, 2.2, 0.5) * _LANE
    angle = angles[lane_of // 2]
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    aside = np.column_stack([-np.sin(angle), np.cos(angle)])
    size = np.exp(world.spread * rng.normal(size=n)) * scale
    half = np.column_stack(
        [
            _CAR[0] * np.abs(np.cos(angle)) + _CAR[1] * np.abs(np.sin(angle)),
            _CAR[0] * np.abs(np.sin(angle)) + _CAR[1] * np.abs(np.cos(angle)),
        ]
    ) * (size[:, None] / 2)
    boxes = np.empty((frames, n, 4))
    identity = np.empty((frames, n), np.int64)
    steps = max(1, int(np.ceil(MIN_RATE / world.fps)))
    for k in range(frames):
        way = (side * traffic.way)[:, None] * along + across[:, None] * aside
        place = centre + scale * way + shift[k]
        boxes[k] = np.concatenate([place - half, place + half], axis=1)
        identity[k] = traffic.identity
        for _ in range(steps):
            traffic.step(1 / (world.fps * steps))
    return boxes, np.broadcast_to(1.0 + rng.random(n), (frames, n)), identity


class _Traffic:
    """The state of cars in lanes: ``way`` from −reach to reach, metres."""

    def __init__(self, world: World, lane: I8, parked: Bool, reach: float, rng: Rng) -> None:
        n = len(lane)
        self.lane = lane
        self.parked = parked
        self.reach = reach
        self.rng = rng
        self.way = np.empty(n)
        for one in np.unique(lane):
            for still in (False, True):
                those = np.flatnonzero((lane == one) & (parked == still))
                slots = np.linspace(-reach, reach, max(len(those), 1) + 1)[:-1]
                jitter = rng.uniform(0, 0.6 * 2 * reach / max(len(those), 1), len(those))
                self.way[those] = slots[: len(those)] + jitter
        self.wanted = np.where(parked, 0.0, world.speed * np.exp(rng.normal(0, 0.2, n)))
        self.pace = self.wanted.copy()
        self.stop = -rng.uniform(5, 15)
        self.green = rng.uniform(*_GREEN)
        self.time = rng.uniform(0, self.green)
        self.identity = np.arange(1, n + 1)
        self.next = n + 1

    def step(self, h: float) -> None:
        """Drive on by ``h`` seconds; roads have green one after the other."""
        self.time += h
        target = self.wanted.copy()
        for one in np.unique(self.lane[~self.parked]):
            those = np.flatnonzero((self.lane == one) & ~self.parked)
            those = those[np.argsort(-self.way[those])]
            gap = np.r_[np.inf, -np.diff(self.way[those]) - _CAR[0] - _GAP]
            if int(self.time / self.green) % 2 != (one // 2) % 2:
                before = self.stop - self.way[those]
                gap = np.where(before > 0, np.minimum(gap, before), gap)
            target[those] = np.minimum(target[those], np.maximum(gap, 0) / _HEADWAY)
        self.pace += (target - self.pace) * min(1.0, h / _CAR_RESPONSE * 2)
        self.way = self.way + h * self.pace
        for gone in np.flatnonzero(self.way > self.reach):
            lane = (self.lane == self.lane[gone]) & ~self.parked
            back = min(-self.reach, self.way[lane].min() - _CAR[0] - _GAP)
            self.way[gone] = back - self.rng.uniform(0, 15)
            self.identity[gone] = self.next
            self.next += 1


def _inside(xyxy: F8, world: World) -> F8:
    """The share of each box's area that is in the frame."""
    cut = clipped(xyxy, world)
    area = np.prod(xyxy[..., 2:] - xyxy[..., :2], axis=-1)
    return np.prod(cut[..., 2:] - cut[..., :2], axis=-1) / np.maximum(area, 1e-9)


def clipped(xyxy: F8, world: World) -> F8:
    """The boxes cut at the frame's borders."""
    return np.clip(xyxy, 0, np.array([world.width, world.height] * 2, np.float64))


def _obstacles(world: World, shift: F8, rng: Rng) -> F8:
    """(T, K, 4) pillars, trees or bridges, which move with the picture."""
    k = world.obstacles
    wide = rng.uniform(0.02, 0.06, k) * world.width
    high = rng.uniform(0.3, 1.0, k) * world.height
    x = rng.uniform(0.1, 0.9, k) * world.width
    y = rng.uniform(0, 1, k) * (world.height - high)
    boxes = np.column_stack([x - wide / 2, y, x + wide / 2, y + high])
    return boxes[None] + np.concatenate([shift, shift], axis=1)[:, None]


def _visible(xyxy: F8, depth: F8, shown: Bool, blocks: F8, world: World) -> F8:
    """(T, N) the share of each box in the frame that nothing hides, on a grid of points."""
    frames, n = depth.shape
    out = np.zeros((frames, n))
    cut = clipped(xyxy, world)
    steps = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    middle = (xyxy[..., ::2].mean(axis=-1), (xyxy[..., 2] - xyxy[..., 0]) * _SOLID / 2)
    hides = xyxy.copy()
    hides[..., 0], hides[..., 2] = middle[0] - middle[1], middle[0] + middle[1]
    ground = world.kind in ON_GROUND
    for k in range(frames):
        those = np.flatnonzero(shown[k])
        box = cut[k, those]
        points = box[:, None, :2] + grid * (box[:, None, 2:] - box[:, None, :2])
        hidden = np.zeros(points.shape[:2], bool)
        for block in blocks[k]:
            hidden |= _within(points, block)
        for j in np.flatnonzero(depth[k] > 0) if ground else ():
            behind = depth[k, those] > depth[k, j]
            hidden[behind] |= _within(points[behind], hides[k, j])
        out[k, those] = 1 - hidden.mean(axis=1)
    return out


def _within(points: F8, box: F8) -> Bool:
    """Which points are in a box."""
    return ((points > box[:2]) & (points < box[2:])).all(axis=-1)
