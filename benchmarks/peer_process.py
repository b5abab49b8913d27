"""Runs one tracker of another library over given detections, in the peers' environment; for
`benchmarks.whole_tracker`.

    python -P peer_process.py TRACKER SETTINGS_JSON DETECTIONS.npz OUT.npz

DETECTIONS holds ``frame`` (M,) from 1, ``xyxy`` (M, 4), ``confidence`` (M,) and ``frames``. OUT
gets ``seconds`` and ``cpu`` (frames,) of the update calls alone, by the clock on the wall and of
processor time, and the rows that the tracker gave: ``frame``, ``identity`` (−1 where a box has none
yet), ``xyxy``. What a library needs as its input is made before the clock starts, what it returns
is read after it stops. Imports nothing of phdtrack.
"""

import json
import sys
import time

import numpy as np


def roboflow(name, settings):
    """The `trackers` package: what makes its input of boxes and scores, the call that is timed,
    what reads its result.
    """
    import supervision as sv
    import trackers

    tracker = {"sort": trackers.SORTTracker, "bytetrack": trackers.ByteTrackTracker}[name](
        **settings
    )

    def prepare(xyxy, confidence):
        # Newer versions of supervision want no empty array of another shape.
        return sv.Detections(
            xyxy.reshape(-1, 4), confidence=confidence, class_id=np.zeros(len(xyxy), int)
        )

    def read(found):
        if found.tracker_id is None:
            return np.zeros(0, int), np.zeros((0, 4))
        return found.tracker_id, found.xyxy

    return prepare, tracker.update, read


def norfair(settings):
    """Norfair with boxes as two points and the vectorised IoU distance."""
    from norfair import Detection, Tracker

    tracker = Tracker(distance_function="iou", **settings)

    def prepare(xyxy, confidence):
        return [
            Detection(box.reshape(2, 2), np.full(2, score))
            for box, score in zip(xyxy, confidence, strict=True)
        ]

    def read(objects):
        if not objects:
            return np.zeros(0, int), np.zeros((0, 4))
        return np.array([o.id for o in objects]), np.array([o.estimate.ravel() for o in objects])

    return prepare, tracker.update, read


def main():
    """One run."""
    name, settings, source, target = sys.argv[1:5]
    given = np.load(source)
    settings = json.loads(settings)
    prepare, update, read = norfair(settings) if name == "norfair" else roboflow(name, settings)
    frames = int(given["frames"])
    ends = np.searchsorted(given["frame"], np.arange(1, frames + 2))
    seconds = np.zeros(frames)
    cpu = np.zeros(frames)
    rows = []
    for index in range(frames):
        lo = ends[index]
        hi = ends[index + 1]
        detections = prepare(given["xyxy"][lo:hi], given["confidence"][lo:hi])
        began = time.perf_counter()
        given_before = time.thread_time()
        found = update(detections)
        seconds[index] = time.perf_counter() - began
        cpu[index] = time.thread_time() - given_before
        identity, xyxy = read(found)
        rows.append((np.full(len(identity), index + 1), identity, xyxy))
    frame, identity, xyxy = (np.concatenate(column) for column in zip(*rows, strict=True))
    np.savez(target, seconds=seconds, cpu=cpu, frame=frame, identity=identity, xyxy=xyxy)


if __name__ == "__main__":
    main()
