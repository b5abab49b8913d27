"""Kernels of merged measurements: what the plain definition finds, with its choice among equals."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from phdtrack import config
from phdtrack.arrays import to_cxcywh
from phdtrack.detect.merged import ExpectedTargets, MergedMeasurements
from phdtrack.models.box import BoxSensor
from phdtrack.types import F8, Detections, Estimates, SequenceInfo
from reference import merged_twin as twin

FRAMES = 150
SECONDS = 1 / 25
MODEL = config.build(config.load(), SequenceInfo(640, 480, 25.0)).model


class Patchy(BoxSensor):
    """A sensor to which detections of confidence 0 show no possible state, and that sees less in
    stripes.
    """

    def measure(self, detections: Detections) -> F8:
        return np.where(detections.confidence > 0, super().measure(detections), np.nan)

    def p_detect(self, x: F8) -> F8:
        return super().p_detect(x) * np.where(x[0] % 60 < 20, 0.4, 1.0)


def model_of(scaling: str):
    return replace(MODEL, sensor=Patchy(scaling=scaling))


def scene(rng: np.random.Generator, spread: float) -> tuple[F8, F8]:
    """Boxes of 1 to 8 targets and of 1 to 8 blobs: of one target, of several, of none; nesting and
    touching.
    """
    n, m = rng.integers(1, 9, 2)
    centre = rng.uniform(100, 100 + spread, (2, n))
    size = rng.uniform(20, 80, (2, n)) * [[1.0], [1.5]]
    boxes = np.vstack([centre - size / 2, centre + size / 2]).T
    if rng.random() < 0.5:
        boxes = np.round(boxes, -1) + np.array([0, 0, 10, 10])
    blobs = []
    for _ in range(m):
        some = boxes[rng.integers(n, size=rng.integers(1, 4))] + rng.normal(0, 1.5, 4) * (
            rng.random() < 0.7
        )
        blobs.append([*some[:, :2].min(axis=0), *some[:, 2:].max(axis=0)])
        if rng.random() < 0.15:
            blobs[-1] = [*centre[:, 0], *(centre[:, 0] + rng.uniform(5, 50, 2))]
    return boxes, np.array(blobs)


def mirrored(rng: np.random.Generator) -> tuple[F8, F8]:
    """The same box several times, and pairs that lie alike about another: equally likely
    explanations.
    """
    box = np.array([100.0, 100, 140, 200])
    step = 4.0 * rng.integers(0, 6)
    shifts = np.array([[-step, 0, -step, 0], [0, 0, 0, 0], [step, 0, step, 0]])
    targets = box + shifts[rng.integers(3, size=rng.integers(1, 4))]
    blobs = box + shifts[rng.integers(3, size=rng.integers(1, 4))]
    if step < 12:
        return targets, blobs
    union = np.concatenate([targets[:, :2].min(axis=0), targets[:, 2:].max(axis=0)])
    return targets, np.vstack([blobs[:1], union])


def lives(rng: np.random.Generator, boxes: F8, model, alike: bool = False) -> ExpectedTargets:
    n = len(boxes)
    state, covariance = model.sensor.states(to_cxcywh(boxes))
    root = rng.normal(0, 0.0 if alike else rng.choice([1.0, 5.0]), (n, 6, 6))
    covariance = 0.05 * covariance + root @ root.transpose(0, 2, 1)
    existence = np.full(n, 0.9) if alike else rng.uniform(0.05, 1.0, n)
    hidden = np.zeros(n) if alike else rng.choice([0.0, 2.0, 4.0], n)
    separate = rng.choice([0.2, 1.0, 1.0, 9.0], n)
    return ExpectedTargets(
        state, covariance, existence, hidden, np.full(n, 9.0) if alike else separate
    )


def frames(kind: str):
    """Frames of rule, model, expected targets and detections."""
    rng = np.random.default_rng(len(kind))
    for k in range(FRAMES):
        model = model_of("particle" if kind == "alike" or k % 2 else "detection")
        boxes, blobs = (
            mirrored(rng)
            if kind == "alike"
            else scene(rng, {"crowded": 60.0, "loose": 300.0}[kind])
        )
        targets = lives(rng, boxes, model, kind == "alike")
        confidence = (rng.random(len(blobs)) > 0.1 * (kind != "alike")).astype(float)
        if kind == "loose":
            blobs[confidence == 0] = np.nan
        rule = MergedMeasurements(float(rng.choice([0.0, 0.01, 0.5, 1.0])), 0.4, 3.0)
        yield rule, model, targets, Detections.of(blobs, confidence), rng


@pytest.mark.parametrize("kind", ["crowded", "loose", "alike"])
def test_explanation_is_that_of_the_definition(kind: str) -> None:
    merged = Counter()
    ties = 0
    for rule, model, given, detections, _ in frames(kind):
        unobserved = Detections.empty(observed=False)
        targets, _ = rule.explain(given, unobserved, model.sensor.measure(unobserved), model, 1.0)
        boxes = model.sensor.boxes(targets.state)
        shown = twin.members(rule, model, targets, detections)
        z = model.sensor.measure(detections)
        after, found = rule.explain(given, detections, z, model, 1.0)
        belongs = [
            found.target[(found.source == b) & (found.target >= 0)] for b in range(len(shown))
        ]
        assert [tuple(several.tolist()) for several in belongs] == shown
        xyxy, source, target = twin.divided(detections.xyxy, boxes, shown)
        assert (found.source.tolist(), found.target.tolist()) == (source, target)
        assert found.part.tolist() == [source.index(b) for b in range(len(shown))]
        assert found.changed == (len(source) > len(detections))
        np.testing.assert_allclose(found.detections.xyxy, xyxy, rtol=0, atol=1e-9)
        for mine, theirs in zip(
            (after.hidden, after.separate), twin.times(targets, boxes, shown, SECONDS), strict=True
        ):
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12)
        merged.update(len(several) for several in shown)
        ties += len(np.unique(detections.xyxy, axis=0)) < len(detections) or len(
            np.unique(boxes, axis=0)
        ) < len(boxes)
    # All that can happen did.
    assert min(merged[0], merged[1], merged[2]) > 10
    assert merged[3] > 0
    assert kind != "alike" or ties > FRAMES // 3


@pytest.mark.parametrize("kind", ["crowded", "loose"])
def test_continuation_is_that_of_the_definition(kind: str) -> None:
    nearest = 0
    kept = 0
    for rule, model, targets, detections, rng in frames(kind):
        z = model.sensor.measure(detections)
        before, found = rule.explain(targets, detections, z, model, 1.0)
        usable = np.flatnonzero(np.isfinite(model.sensor.measure(found.detections)).all(axis=0))
        state, covariance = model.sensor.states(
            np.ascontiguousarray(to_cxcywh(found.detections.xyxy[usable]))
        )
        # Some rest on no detection, some on one of another, some targets are not shown.
        detection = np.where(
            rng.random(len(usable)) < 0.5,
            -1,
            rng.choice(usable, len(usable)) if len(usable) else -1,
        )
        weight = rng.uniform(0.5, 1.2, len(usable))
        boxes = found.detections.xyxy[usable]
        estimates = Estimates(state, covariance, weight, boxes, detection).select(
            rng.random(len(usable)) < 0.7
        )
        after = rule.advance(before, found, estimates, model, 1.0)
        of = twin.continued(before, found.target, estimates, model)
        left, existence, late = twin.unseen(rule, before, found.target, of, model, SECONDS)
        hidden, separate = (np.append(value, 0.0)[of] for value in (before.hidden, before.separate))
        np.testing.assert_allclose(
            after.existence, [*np.minimum(estimates.weight, 0.99), *existence], rtol=1e-12
        )
        np.testing.assert_allclose(after.hidden, [*hidden, *late], rtol=1e-12)
        np.testing.assert_allclose(after.separate, [*separate, *before.separate[left]], rtol=1e-12)
        np.testing.assert_array_equal(
            after.state, np.hstack([estimates.state, before.state[:, left]])
        )
        np.testing.assert_array_equal(
            after.covariance, np.concatenate([estimates.covariance, before.covariance[left]])
        )
        nearest += (of[estimates.detection < 0] >= 0).sum()
        kept += len(left)
    assert min(nearest, kept) > 20
