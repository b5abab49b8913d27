"""Whether what is followed somewhere is a false alarm: how often a person saw either there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.kernels.box import OBSERVED
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects
from phdtrack.scene.mixture import marginal

LOW = np.zeros(4)
HIGH = np.array([640.0, 480, 640, 480])
VOLUME = (640.0 * 480) ** 2
FLAG, DOOR, STREET = (
    np.array([p], np.float64).T for p in ([500, 100, 40, 60], [60, 300, 40, 90], [300, 300, 40, 90])
)
ANYWHERE = np.array([[400.0], [50], [20], [20]])
BEYOND = np.array([[-30.0], [500], [40], [90]])


def at(place: np.ndarray, deviation: float, uniform: float) -> SceneDensity:
    """One place where boxes are detected, seldom anywhere else."""
    return SceneDensity(LOW, HIGH, uniform, np.ones(1), place, deviation**2 * np.eye(4)[None])


FLAGS = LearnedDensity(3.0, at(FLAG, 4.0, 0.1))
PEOPLE = LearnedDensity(5.0, at(STREET, 20.0, 0.3))
ODDS = FalseAlarmRatio(FLAGS, TrackedObjects(0.4, PEOPLE))


# With the velocities, of which the odds know nothing.
ENTRY = SceneDensity(
    np.array([0.0, 0, -9, -9, 0, 0]),
    np.array([640.0, 480, 9, 9, 640, 480]),
    0.2,
    np.ones(1),
    np.vstack([DOOR[:2], [[3], [0]], DOOR[2:]]),
    np.diag([25.0, 25, 1, 1, 25, 25])[None],
)


def followed(z, odds: FalseAlarmRatio = ODDS) -> np.ndarray:
    """(N,) of those that are followed."""
    return odds.log(z)[0]


def test_false_alarms_are_only_where_they_were_marked():
    """Their uniform part tells of no place, so that an object may be anywhere else, beyond the
    volume too.
    """
    z = np.hstack([FLAG, STREET, ANYWHERE, BEYOND, DOOR])
    assert (followed(z) < 0).tolist() == [False, True, True, True, True]
    assert np.isfinite(ODDS.log(z)).all()


@given(
    x=st.floats(-100, 740),
    y=st.floats(-100, 580),
    w=st.floats(1, 700),
    h=st.floats(1, 700),
    share=st.floats(0, 1),
    rate=st.floats(0, 50),
    seen=st.floats(0, 50),
)
def test_odds_are_finite_and_followed_ones_fewer(x, y, w, h, share, rate, seen):
    z = np.array([[x], [y], [w], [h]])
    objects = LearnedDensity(seen, PEOPLE.density)
    some, any_ = FalseAlarmRatio(
        LearnedDensity(rate, FLAGS.density), TrackedObjects(share, objects)
    ).log(z)[:, 0]
    assert np.isfinite([some, any_]).all()
    assert some <= any_ + 1e-12
    assert (
        followed(
            z,
            FalseAlarmRatio(
                LearnedDensity(rate, FLAGS.density), TrackedObjects(share / 2, objects)
            ),
        )[0]
        <= some + 1e-12
    )


@pytest.mark.parametrize(
    "births", [None, LearnedDensity(0.02, ENTRY)], ids=["people", "people who enter"]
)
def test_it_is_what_the_densities_say(births, rng):
    """Anywhere, against the densities one by one: beyond their volumes there are their uniform
    parts.

    Of false alarms that are seen once the uniform part counts too, and not whether they are
    followed; who comes in is one of as many detections as objects have, spread as places of births.
    """
    near = np.hstack([place + rng.normal(0, 4, (4, 30)) for place in (FLAG, DOOR, STREET)])
    z = np.hstack([near, FLAG, ANYWHERE, BEYOND])
    alarms = LearnedDensity(
        3.0, SceneDensity(LOW, HIGH, 0.1, np.ones(1), STREET, 900 * np.eye(4)[None])
    )
    entry = marginal(ENTRY, OBSERVED)
    places = alarms.rate * np.maximum(alarms.density(z) - alarms.density.flat, 0)
    people = PEOPLE.rate * np.maximum(PEOPLE.density(z), PEOPLE.density.flat)
    enter = PEOPLE.rate * np.maximum(entry(z) - entry.flat, 0) if births else 0
    log = FalseAlarmRatio(alarms, TrackedObjects(0.4, PEOPLE), births).log(z)
    np.testing.assert_allclose(
        log[1], np.log((places + alarms.rate * alarms.density.flat) / (people + enter)), rtol=1e-6
    )
    followed = 0.4 * places / people
    some = followed > np.exp(-20)
    assert some.sum() >= 25
    np.testing.assert_allclose(log[0, some], np.log(followed[some]), rtol=1e-4)
