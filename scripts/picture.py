"""Make the pictures of the documentation from rendered scenes.

``python scripts/picture.py`` writes docs/picture.jpg: detections with clutter, the filter's
intensity, the tracks. ``python scripts/picture.py gallery`` writes docs/gallery/: the first command
on each scene, and the effect of teaching a scene. ``python scripts/picture.py animation`` writes
docs/animation.webp: the demo without and with the filter.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from phdtrack import Detections, Tracker, Tracks
from phdtrack.formats import find_seqinfo, read_detections, read_tracks, read_truth
from phdtrack.label import LabelStore
from phdtrack.label.samples import shuffled
from phdtrack.label.sequences import open_sequence
from phdtrack.report import Annotator
from phdtrack.run.requests import SourceRequest
from phdtrack.scene.mixture import place_map
from phdtrack.scene.scene_file import read_scene
from phdtrack.simulate import DetectorModel, Look, Rendered, make_scene
from phdtrack.video import open_source

OUT = Path(__file__).resolve().parent.parent / "docs" / "picture.jpg"
FRAME = 280
SEED = 7
CLUTTER = 8.0
# Scenes of the gallery, and the frame of each that is shown.
SCENES = ("yard", "garden", "arcade", "crowd")
SHOWN = 400
MARKED = 40
WHITE = (255, 255, 255)
# Frames of the demo that are shown, the step between them, and the width of each half in pixels.
MOVING = range(120, 280)
STEP = 2
HALF = 480


def main() -> None:
    """Track the scene up to one frame and draw it three times."""
    scene = make_scene(
        "street", SEED, DetectorModel(p_detect=0.9, clutter_rate=CLUTTER), frames=FRAME + 20
    )
    info = scene.info
    tracker = Tracker((info.width, info.height), fps=info.fps, seed=SEED, filter="particle-phd")
    annotate = Annotator(info)
    none = Tracks.empty()
    heat = np.zeros((1, 1))
    pictures = []
    for frame in Rendered(scene, np.random.default_rng(SEED), Look(lamps=0)):
        tracker.update(scene.detections.at(frame.number), frame=frame.number, timestamp=frame.time)
        pictures.append(frame.image)
        if frame.number == FRAME:
            particles = tracker.state.intensity
            edges = ((0, info.height), (0, info.width))
            cells = (info.height // 4, info.width // 4)
            heat, _, _ = np.histogram2d(
                *particles.state[1::-1], cells, edges, weights=particles.weight
            )
            heat = cv2.GaussianBlur(heat, (5, 5), 1.0)
    tracks = tracker.tracks()
    for number in range(FRAME - 60, FRAME + 1):
        drawn = annotate(pictures[number - 1], number, tracks, Detections.empty())
    image = pictures[FRAME - 1]
    seen = Annotator(info)(image, FRAME, none, scene.detections.at(FRAME))
    panels = [
        _named(seen, f"{len(scene.detections.at(FRAME))} detections"),
        _named(_glow(image, heat), "the filter's intensity"),
        _named(drawn, "tracks"),
    ]
    _write(OUT, panels)


def gallery() -> None:
    """Run the commands in a temporary folder, and show a frame of their output."""
    out = OUT.parent / "gallery"
    out.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        at = Path(name)
        for scene in SCENES:
            _phdtrack(at, "simulate", scene, "--frames", str(SHOWN + 100), "--out", scene)
            _phdtrack(at, "track", f"{scene}/scene.mp4", "--out", f"runs/{scene}")
            _write(
                out / f"{scene}.jpg",
                [_seen(at, scene, "runs/" + scene), _tracked(at, scene, "runs/" + scene, "tracks")],
            )
        _learned(at, out)


def animation() -> None:
    """Run the demo, and show its two annotated videos side by side."""
    with tempfile.TemporaryDirectory() as name:
        at = Path(name)
        _phdtrack(at, "demo", "--out", "demo")
        halves = [
            [
                _named(_shrunk(frame.image), text)
                for frame in islice(
                    open_source(str(at / "demo" / file)), MOVING.start, MOVING.stop, STEP
                )
            ]
            for file, text in (
                ("without-filter/annotated.mp4", "boxes linked without a filter"),
                ("annotated.mp4", "the same boxes with phdtrack"),
            )
        ]
    pictures = [Image.fromarray(np.hstack(pair)[:, :, ::-1]) for pair in zip(*halves, strict=True)]
    first, *rest = pictures
    # Browsers and GitHub show it; a GIF of the same quality is three times as large.
    first.save(
        OUT.parent / "animation.webp",
        save_all=True,
        append_images=rest,
        duration=round(1000 * STEP / 25),
        loop=0,
        quality=55,
        method=6,
    )


def _shrunk(image: np.ndarray) -> np.ndarray:
    """The image in the width of a half."""
    height = round(image.shape[0] * HALF / image.shape[1])
    return cv2.resize(image, (HALF, height), interpolation=cv2.INTER_AREA)


def _learned(at: Path, out: Path) -> None:
    """Track the yard's detections before and after 40 frames of them are marked."""
    detections = at / "yard" / "det" / "det.txt"
    labels = at / "yard.labels.sqlite"
    found = open_sequence(SourceRequest(detections=detections), {}, labels)
    truth = read_truth(at / "yard" / "gt" / "gt.txt")
    store = LabelStore.open(
        labels, str(detections), found.digest, shuffled(found.info.frames, seed=0)[:MARKED]
    )
    store.mark_false(found.table, truth)
    given = ("--detections", "yard/det/det.txt")
    _phdtrack(at, "learn", *given, "--labels", labels.name, "--out", "yard.scene.json")
    _phdtrack(at, "track", *given, "--out", "runs/before", "--no-video")
    _phdtrack(
        at, "track", *given, "--out", "runs/after", "--no-video", "--scene", "yard.scene.json"
    )
    image = _frame(at, "yard")
    density = read_scene(at / "yard.scene.json").clutter.density
    heat = place_map(density, (image.shape[0] // 4, image.shape[1] // 4), 4.0)
    places = _named(_glow(image, heat), "where false alarms are expected")
    _write(out / "detections-and-places.jpg", [_seen(at, "yard", "runs/before"), places])
    both = [
        _tracked(at, "yard", "runs/before", "tracks, untaught"),
        _tracked(at, "yard", "runs/after", "tracks, taught"),
    ]
    _write(out / "before-and-after.jpg", both)


def _phdtrack(at: Path, *words: str) -> None:
    """Run a command in this folder."""
    subprocess.run([sys.executable, "-m", "phdtrack", *words, "--quiet"], cwd=at, check=True)


def _frame(at: Path, scene: str) -> np.ndarray:
    """Return the frame to show."""
    return next(islice(open_source(str(at / scene / "scene.mp4")), SHOWN - 1, None)).image


def _seen(at: Path, scene: str, run: str) -> np.ndarray:
    """Draw the detections of a run."""
    found = read_detections(at / run / "detections.csv").at(SHOWN)
    drawn = Annotator(find_seqinfo(at / scene))(_frame(at, scene), SHOWN, Tracks.empty(), found)
    return _named(drawn, f"{len(found)} detections")


def _tracked(at: Path, scene: str, run: str, text: str) -> np.ndarray:
    """Draw the corrected tracks of a run, with their paths in the last seconds."""
    annotate = Annotator(find_seqinfo(at / scene))
    tracks = read_tracks(at / run / "tracks.csv")
    for frame in islice(open_source(str(at / scene / "scene.mp4")), SHOWN):
        if frame.number > SHOWN - 60:
            drawn = annotate(frame.image, frame.number, tracks, Detections.empty())
    return _named(drawn, text)


def _write(path: Path, panels: list[np.ndarray]) -> None:
    """Write the panels side by side."""
    gap = np.full((panels[0].shape[0], 8, 3), 255, np.uint8)
    row = [one for panel in panels for one in (gap, panel)][1:]
    cv2.imwrite(str(path), np.hstack(row), [cv2.IMWRITE_JPEG_QUALITY, 80])


def _glow(image: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Draw the intensity over the darkened frame."""
    level = cv2.resize(
        heat / max(heat.max(), 1e-9),
        (image.shape[1], image.shape[0]),
        interpolation=cv2.INTER_LINEAR,
    )
    colour = cv2.applyColorMap((255 * level**0.5).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return cv2.addWeighted(image, 0.35, colour, 0.9, 0)


def _named(image: np.ndarray, text: str) -> np.ndarray:
    """Write the name at the foot of a panel."""
    out = image.copy()
    cv2.rectangle(out, (0, out.shape[0] - 30), (out.shape[1], out.shape[0]), (40, 40, 40), -1)
    cv2.putText(
        out, text, (10, out.shape[0] - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.65, WHITE, 1, cv2.LINE_AA
    )
    return out


if __name__ == "__main__":
    {"gallery": gallery, "animation": animation}.get("".join(sys.argv[1:]), main)()
