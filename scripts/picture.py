"""The README's picture: detections with clutter, the intensity that the filter makes of them, the tracks.

python scripts/picture.py          writes docs/picture.jpg
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from phdtrack import Detections, Tracker, Tracks
from phdtrack.report import Annotator
from phdtrack.simulate import DetectorModel, Look, Rendered, make_scene

OUT = Path(__file__).resolve().parent.parent / "docs" / "picture.jpg"
FRAME, SEED, CLUTTER = 280, 7, 8.0
WHITE = (255, 255, 255)


def main() -> None:
    """Track the scene up to one frame and draw it three times."""
    scene = make_scene("street", SEED, DetectorModel(p_detect=0.9, clutter_rate=CLUTTER), frames=FRAME + 20)
    info = scene.info
    tracker = Tracker((info.width, info.height), fps=info.fps, seed=SEED, filter="particle-phd")
    annotate, none = Annotator(info), Tracks.empty()
    heat = np.zeros((1, 1))
    pictures = []
    for frame in Rendered(scene, np.random.default_rng(SEED), Look(lamps=0)):
        tracker.update(scene.detections.at(frame.number), frame=frame.number, timestamp=frame.time)
        pictures.append(frame.image)
        if frame.number == FRAME:
            particles, edges = tracker.state.intensity, ((0, info.height), (0, info.width))
            cells = (info.height // 4, info.width // 4)
            heat, _, _ = np.histogram2d(*particles.state[1::-1], cells, edges, weights=particles.weight)
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
    gap = np.full((image.shape[0], 8, 3), 255, np.uint8)
    cv2.imwrite(str(OUT), np.hstack([panels[0], gap, panels[1], gap, panels[2]]), [cv2.IMWRITE_JPEG_QUALITY, 85])


def _glow(image: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """The intensity over the darkened frame."""
    level = cv2.resize(heat / max(heat.max(), 1e-9), (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)
    colour = cv2.applyColorMap((255 * level**0.5).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return cv2.addWeighted(image, 0.35, colour, 0.9, 0)


def _named(image: np.ndarray, text: str) -> np.ndarray:
    """The panel with its name at the foot."""
    out = image.copy()
    cv2.rectangle(out, (0, out.shape[0] - 30), (out.shape[1], out.shape[0]), (40, 40, 40), -1)
    cv2.putText(out, text, (10, out.shape[0] - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.65, WHITE, 1, cv2.LINE_AA)
    return out


if __name__ == "__main__":
    main()
