"""Cameras drawn at random: a seed gives a world, a detector, its truth and its detections.

Nothing here is fitted to real sequences or to a tracker: every range is that of a quantity as one
finds it among cameras, objects and detectors, with the reason beside it, and all are drawn
independently. Imports nothing of phdtrack: the environment of the peers has neither its
dependencies nor itself.
"""

from __future__ import annotations

import configparser
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.synthetic_detector import DetectorLaw, SimulatedDetections, detect
from experiments.synthetic_worlds import F8, I8, Figures, Rng, World, clipped, figures

# Cameras for development, and those of the final figure, which nobody looks at one by one.
DEVELOPMENT = tuple(range(1, 21))
FINAL = tuple(range(101, 121))
# Numbers that keep these streams of random numbers apart from those of other seeds.
_SALT = 20261129
# Sizes of frames: a webcam, a phone's clip, two formats of security cameras.
FRAMES = ((640, 480), (960, 540), (1280, 720), (1920, 1080))
# A clip of a scene: shorter ones are no test of identities, longer ones repeat themselves.
SECONDS = (10.0, 60.0)
# At a low rate a clip is as long as this number of frames takes, within the range above.
LEAST_FRAMES = 40
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class KindLaw:
    """The ranges of what is drawn for a kind of object; pairs are lowest and highest value.

    Attributes
    ----------
    fps : frames a second.
    count : objects at a time.
    size : height (aerial: length of a car), as a share of the frame's height; that of cars from a
        car follows from their distance.
    speed : metres a second (cells: sizes a second).
    turn : rad per root second.
    standing : share of the time.
    spread : deviation of the logarithm of sizes.
    change : widening by arms and legs, as a share of the width.
    cameras : kinds of motion of the camera, each as probable as the others.
    """

    fps: Range
    count: Range
    size: Range
    speed: Range
    turn: Range
    standing: Range
    spread: Range
    change: Range
    cameras: tuple[str, ...]


KINDS = {
    # People walk at 0.8 to 1.6 m/s; security cameras store as little as a frame a second, and
    # phones up to 60; from a few to a crowd; a third of a frame high before a shop, a twentieth in
    # a square; waiting people stand. Statures differ by 6 %, with children by more.
    "pedestrian": KindLaw(
        fps=(1, 60),
        count=(3, 40),
        size=(0.06, 0.35),
        speed=(0.8, 1.6),
        turn=(0.1, 0.5),
        standing=(0.0, 0.5),
        spread=(0.05, 0.15),
        change=(0.05, 0.2),
        cameras=("fixed", "fixed", "pan", "shake"),
    ),
    # Seen from a driving car: cameras in cars have 5 to 30 frames; towns to country roads; up to
    # half of the cars are parked. A car's box changes with its direction by itself.
    "car": KindLaw(
        fps=(5, 30),
        count=(8, 30),
        size=(0.1, 0.1),
        speed=(5, 20),
        turn=(0.0, 0.0),
        standing=(0.2, 0.7),
        spread=(0.05, 0.2),
        change=(0.0, 0.0),
        cameras=("drive",),
    ),
    # A stage or a studio, filmed at 15 frames or more: dancers step to and fro, whirl, spread their
    # arms, bow, and hide each other.
    "dancer": KindLaw(
        fps=(15, 60),
        count=(3, 16),
        size=(0.25, 0.6),
        speed=(0.5, 1.5),
        turn=(1.0, 3.0),
        standing=(0.2, 0.6),
        spread=(0.03, 0.08),
        change=(0.2, 0.5),
        cameras=("fixed", "pan", "shake"),
    ),
    # Microscopes: cells creep by a part of their size a second (of the video, whatever time it
    # shows), and grow to different sizes; the stage jitters.
    "cell": KindLaw(
        fps=(1, 30),
        count=(8, 40),
        size=(0.03, 0.1),
        speed=(0.02, 0.4),
        turn=(0.3, 2.0),
        standing=(0.0, 0.3),
        spread=(0.1, 0.3),
        change=(0.0, 0.3),
        cameras=("fixed", "fixed", "shake"),
    ),
    # Two teams of 5 to 11 and referees; sprints of up to 8 m/s; a camera that follows the game.
    "player": KindLaw(
        fps=(10, 60),
        count=(8, 24),
        size=(0.08, 0.25),
        speed=(1.5, 4.0),
        turn=(0.3, 1.5),
        standing=(0.0, 0.3),
        spread=(0.03, 0.1),
        change=(0.1, 0.4),
        cameras=("pan", "pan", "fixed"),
    ),
    # Drones at 20 to 120 m; town traffic, with lights; parked cars.
    "aerial": KindLaw(
        fps=(1, 60),
        count=(6, 40),
        size=(0.04, 0.12),
        speed=(6, 16),
        turn=(0.0, 0.0),
        standing=(0.0, 0.6),
        spread=(0.05, 0.2),
        change=(0.0, 0.0),
        cameras=("fixed", "pan", "shake"),
    ),
}
# People who wait, dancers who pose: seconds.
DWELL = (1.0, 15.0)
# A camera that pans slowly and one that follows a run, frame widths a second; a hand and a mast in
# the wind, deviation in frame widths; a car in a town and on a country road, metres a second.
CAMERA_RATES = {
    "fixed": (0.0, 0.0),
    "pan": (0.02, 0.2),
    "shake": (0.001, 0.01),
    "drive": (3.0, 18.0),
}
# Pillars, trees, signs.
OBSTACLES = (0, 3)
# Detectors of today find 0.7 to 0.98 of what is visible, and less of what is half hidden.
P_DETECT = (0.7, 0.98)
OCCLUSION = (0.5, 2.0)
# From independent misses to those of one pose or one light.
MISS_MEMORY = (0.0, 1.0)
# A detector with a threshold of 0.5, and one with 0.05.
LOW_SHARE = (0.0, 0.7)
MERGING = (0.0, 0.6)
# Sharp scores are those of a network that knows the scene; weak ones of one that does not, of
# background subtraction uninformative ones or none. As probable as one meets them: networks more.
SCORE_CHANCES = {"sharp": 0.35, "weak": 0.3, "uninformative": 0.15, "none": 0.2}
# Below 1 a detector that is sure, above 1 one whose scores are all low.
SCORE_POWER = (0.7, 2.5)
# At 0.01 as good as an annotator; at 0.08 an IoU of 0.75 with the truth.
CENTRE_NOISE = (0.01, 0.06)
SIZE_NOISE = (0.01, 0.08)
NOISE_MEMORY = (0.0, 1.0)
PARTS = (0.0, 0.05)
PARTS_HIDDEN = (0.0, 0.4)
DOUBLES = (0.0, 0.04)
# Thresholds of non-maximum suppression that people set.
OVERLAP = (0.45, 0.75)
# From one false alarm in a minute to three a frame; low ones, of a low threshold, more.
CLUTTER = (0.005, 3.0)
LOW_CLUTTER = (0.1, 8.0)
# Posters, reflections, plants; on for a moment or for long.
PLACES = (0, 6)
PLACE_ON = (0.2, 10.0)
PLACE_OFF = (0.5, 20.0)
PLACE_FIRES = (0.3, 0.95)


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticCamera:
    """A camera with truth and detections.

    Attributes
    ----------
    seed : that gives this camera.
    world, law : what was drawn.
    figures : boxes of the objects in all frames.
    detections : of the simulated detector.
    """

    seed: int
    world: World
    law: DetectorLaw
    figures: Figures
    detections: SimulatedDetections

    @property
    def name(self) -> str:
        """The name of the camera as a sequence."""
        return name_of(self.seed)

    def truth(self) -> tuple[I8, I8, F8]:
        """Frame from 1 (M,), identity (M,) and xyxy (M, 4) of the objects, cut at the frame."""
        k, i = np.nonzero(self.figures.shown)
        return (
            k + 1,
            self.figures.identity[k, i],
            np.round(clipped(self.figures.xyxy[k, i], self.world), 2),
        )


def name_of(seed: int) -> str:
    """The name of the camera of a seed."""
    return f"camera-{seed}"


def seed_of(name: str) -> int:
    """The seed of a camera by its name."""
    return int(name.removeprefix("camera-"))


def drawn(seed: int, kind: str | None = None) -> tuple[World, DetectorLaw]:
    """The parameters of a camera; ``kind`` instead of its own.

    Six seeds, from a multiple of six on, have all kinds of objects in random order.
    """
    world_rng, law_rng = np.random.default_rng([_SALT, seed]).spawn(2)
    order = np.random.default_rng([_SALT, seed // len(KINDS), 1]).permutation(list(KINDS))
    return _world(world_rng, kind or str(order[seed % len(KINDS)])), _law(law_rng)


def camera(seed: int, seconds: float | None = None, kind: str | None = None) -> SyntheticCamera:
    """The camera of a seed. With ``seconds`` it is another, shorter clip of the same camera; with
    ``kind`` other objects move in front of it.
    """
    world, law = drawn(seed, kind)
    if seconds is not None:
        world = replace(world, frames=min(world.frames, round(seconds * world.fps)))
    _, _, objects_rng, detector_rng = np.random.default_rng([_SALT, seed]).spawn(4)
    shown = figures(world, objects_rng)
    return SyntheticCamera(seed, world, law, shown, detect(world, shown, law, detector_rng))


def _between(rng: Rng, limits: Range, digits: int = 3) -> float:
    """A uniform value."""
    return round(float(rng.uniform(*limits)), digits)


def _ratio(rng: Rng, limits: Range, digits: int = 3) -> float:
    """A value whose logarithm is uniform."""
    low, high = limits
    return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), digits)


def _world(rng: Rng, kind: str) -> World:
    """What is in front of the camera."""
    law = KINDS[kind]
    width, height = FRAMES[rng.integers(len(FRAMES))]
    fps = max(1.0, round(_ratio(rng, law.fps)))
    seconds = max(_between(rng, SECONDS), LEAST_FRAMES / fps)
    moves = law.cameras[int(rng.integers(12)) % len(law.cameras)]
    return World(
        kind=kind,
        width=width,
        height=height,
        fps=fps,
        frames=round(seconds * fps),
        count=round(_ratio(rng, law.count)),
        speed=_ratio(rng, law.speed),
        turn=_between(rng, law.turn),
        standing=_between(rng, law.standing),
        dwell=_ratio(rng, DWELL),
        size=_ratio(rng, law.size) * height,
        spread=_between(rng, law.spread),
        change=_between(rng, law.change),
        camera=moves,
        camera_rate=_between(rng, CAMERA_RATES[moves], 4),
        obstacles=0 if moves == "drive" else int(rng.integers(OBSTACLES[0], OBSTACLES[1] + 1)),
    )


def _law(rng: Rng) -> DetectorLaw:
    """How the detector errs. Only scores that tell objects from false alarms have low ones."""
    scores = str(rng.choice(list(SCORE_CHANCES), p=list(SCORE_CHANCES.values())))
    tells = scores in ("sharp", "weak")
    low_share = _between(rng, LOW_SHARE)
    low_clutter = _ratio(rng, LOW_CLUTTER)
    return DetectorLaw(
        p_detect=_between(rng, P_DETECT),
        occlusion=_between(rng, OCCLUSION),
        miss_memory=_between(rng, MISS_MEMORY),
        low_share=low_share if tells else 0.0,
        merging=_between(rng, MERGING),
        scores=scores,
        score_power=_ratio(rng, SCORE_POWER),
        centre_noise=_between(rng, CENTRE_NOISE),
        size_noise=_between(rng, SIZE_NOISE),
        noise_memory=_between(rng, NOISE_MEMORY),
        parts=_between(rng, PARTS),
        parts_hidden=_between(rng, PARTS_HIDDEN),
        doubles=_between(rng, DOUBLES),
        overlap=_between(rng, OVERLAP),
        clutter=_ratio(rng, CLUTTER),
        low_clutter=low_clutter if tells else 0.0,
        places=int(rng.integers(PLACES[0], PLACES[1] + 1)),
        place_on=_ratio(rng, PLACE_ON),
        place_off=_ratio(rng, PLACE_OFF),
        place_fires=_between(rng, PLACE_FIRES),
    )


def described(world: World, law: DetectorLaw) -> str:
    """A camera in one line."""
    names = {"car": "cars from a car", "aerial": "cars from above"}
    moves = {"fixed": "fixed", "pan": "panning", "shake": "shaking", "drive": "driving"}
    scores = {"none": "no scores"}.get(law.scores, f"{law.scores} scores")
    return (
        f"{world.count} {names.get(world.kind, world.kind + 's')}, {moves[world.camera]} camera,"
        f" {world.width}x{world.height}, {world.fps:.0f} Hz, {world.frames} frames;"
        f" p_D {law.p_detect:.2f}, {scores}, {law.clutter + law.low_clutter:.1f} uniform false"
        f" alarms a frame, {law.places} places"
    )


def write_camera(one: SyntheticCamera, folder: Path) -> None:
    """Write seqinfo.ini, gt/gt.txt and det_synthetic/det.txt in the MOTChallenge format."""
    world, found = one.world, one.detections
    for name in ("gt", "det_synthetic"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    ini = configparser.ConfigParser()
    ini.optionxform = str  # type: ignore[assignment, method-assign]
    ini["Sequence"] = {
        "name": one.name,
        "seqLength": str(world.frames),
        "imWidth": str(world.width),
        "imHeight": str(world.height),
        "frameRate": str(world.fps),
    }
    with (folder / "seqinfo.ini").open("w", encoding="utf-8") as file:
        ini.write(file)
    frame, identity, xyxy = one.truth()
    _save(folder / "gt" / "gt.txt", frame, identity, xyxy, np.ones(len(frame)))
    nobody = np.full(len(found.frame), -1)
    _save(folder / "det_synthetic" / "det.txt", found.frame, nobody, found.xyxy, found.score)


def _save(path: Path, frame: I8, identity: I8, xyxy: F8, score: F8) -> None:
    """Write rows of a MOT file."""
    rest = np.full((len(frame), 3), -1)
    rows = np.column_stack([frame, identity, xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2], score, rest])
    form = ["%d", "%d", "%.2f", "%.2f", "%.2f", "%.2f", "%.4f", "%d", "%d", "%d"]
    np.savetxt(path, rows, delimiter=",", fmt=form)
