"""The cameras of the real sequences, against the places that their own annotations give."""

from pathlib import Path

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.formats import read_truth
from phdtrack.ground import MatrixForm, footprint, read_camera

pytestmark = pytest.mark.data


def test_pets_foot_points_agree_with_the_truth(data: Path) -> None:
    camera = read_camera(data / "pets2009" / "View_001.xml")
    rows = np.loadtxt(data / "mot15" / "PETS09-S2L1" / "gt" / "gt.txt", delimiter=",")
    foot = np.stack([rows[:, 2] + rows[:, 4] / 2, rows[:, 3] + rows[:, 5]])
    place = rows[:, 7:9].T
    assert np.median(np.hypot(*(camera.ground(foot) - place))) < 0.125
    # MOTChallenge counts pixels from 1, a calibration from 0: that alone is most of it.
    assert np.median(np.hypot(*(camera.ground(foot - 1) - place))) < 0.04
    assert np.nanmedian(np.hypot(*(camera.pixels(place) - foot + 1))) < 1.0
    np.testing.assert_allclose(camera.position, [-28.94, -19.53, 7.07], atol=0.01)
    polygon = footprint(camera, (768, 576), 60.0)
    assert (polygon.min(axis=1) > -25).all()
    assert (polygon.max(axis=1) < 40).all()


@pytest.mark.parametrize(("name", "size"), [("seq_eth", (640, 480)), ("zara01", (720, 590))])
def test_pedestrians_of_eth_and_ucy_are_in_the_image(
    data: Path, name: str, size: tuple[int, int]
) -> None:
    """The annotations of zara01 go 10 pixels below the frame of 576 rows."""
    camera = read_camera(data / "groups" / name / "H.txt")
    place = np.loadtxt(data / "groups" / name / "obsmat.txt")[:, [2, 4]].T
    pixel = camera.pixels(place)
    assert ((pixel >= 0) & (pixel <= np.array(size)[:, None])).all()
    np.testing.assert_allclose(camera.ground(pixel), place, atol=1e-9)


def test_caviar_transforms_give_metres(data: Path) -> None:
    """People in a corridor: those who are not far away keep within a few metres across, and
    walk.
    """
    path = data / "caviar" / "caviar_homography.mat"
    with pytest.raises(InputError, match="got c2b, f2b"):
        read_camera(path)
    camera = read_camera(path, MatrixForm(variable="c2b", unit="cm"))
    truth = read_truth(data / "caviar" / "cols1gt.xml")
    foot = np.stack([truth.xyxy[:, [0, 2]].mean(axis=1), truth.xyxy[:, 3]])
    near = foot[1] > 80
    ground = camera.ground(foot[:, near])
    assert np.ptp(ground[0]) < 8
    speeds = []
    for identity in np.unique(truth.identity[near]):
        way = ground[:, truth.identity[near] == identity]
        speeds.append(
            np.median(np.hypot(*(way[:, 25:] - way[:, :-25]))) if way.shape[1] > 50 else 0.0
        )
    assert 0.8 < max(speeds) < 2.0, "metres in a second, 25 frames"
