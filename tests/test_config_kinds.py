"""Kinds of filters and extractions: which one wins, what it brings along, and what does not go
together.
"""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack import config
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.config.presets import PRESETS
from phdtrack.errors import InputError
from phdtrack.filters import MHT, BestHypothesis
from phdtrack.filters.extract import Components
from phdtrack.models import PlaneBirth, PlaneClutter, PlaneMotion, PlaneSensor
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)


# D14's births, anywhere in the image, have no Gaussian form.
@pytest.mark.parametrize("preset", sorted({*PRESETS} - {"d14"}))
def test_a_filter_brings_an_extraction_that_fits_it(preset: str, tmp_path):
    """By option, by a file and by name; what both kinds of extraction have stays."""
    path = tmp_path / "mine.toml"
    path.write_text("[extract]\nmerge_iou = 0.7\n[filter]\nkind = 'gm-phd'\n", encoding="utf-8")
    for settings, overlap in (
        (config.load(sets=["extract.merge_iou=0.3", "filter.kind=gm-phd"], preset=preset), 0.3),
        (config.load(path, preset=preset), 0.7),
        (
            config.overlay(
                config.load(preset=preset),
                {"extract": {"merge_iou": 0.6}, "filter": {"kind": "gm-phd"}},
            ),
            0.6,
        ),
    ):
        assert settings.as_dict()["extract"] == {
            **settings.as_dict()["extract"],
            "kind": "components",
            "merge_iou": overlap,
        }
    assert isinstance(
        config.build(config.load(preset=preset), INFO, "gm-phd").extractor, Components
    )


@pytest.mark.parametrize(("sets", "says"), [
    (["filter.kind=gm-phd", "extract.kind=kmeans"], "Use extract.kind=components, or"),
    (["extract.kind=mixture", "filter.kind=gm-phd"], "Use extract.kind=components, or"),
    (["filter.kind=particle-phd", "extract.kind=components"], "kmeans or mixture"),
    (["filter.kind=gm-phd", "associate.kind=labelled"], "Use associate.kind=graph, or"),
    (["extract.kind=kmeans"], "Use extract.kind=bernoullis, or another filter.kind"),
    (["motion.kind=point", "birth.kind=measurement"], "does not fit"),
    (["sensor.kind=point"], "does not fit"),
    (["birth.kind=point"], "does not fit"),
    (["birth.kind=uniform"], "Use birth.kind=measurement, or another motion.kind"),
    (["motion.kind=point", "birth.kind=uniform"], "Use filter.kind=particle-phd or"),
    (["motion.kind=point", "filter.kind=gm-cphd", "birth.kind=uniform"], "or another birth.kind"),
    (["filter.kind=particle-cphd", "extract.kind=components"], "extract.kind=mixture or kmeans"),
])  # fmt: skip
def test_kinds_that_do_not_go_together(sets: list[str], says: str):
    with pytest.raises(InputError, match=says):
        config.load(sets=sets)


@pytest.mark.parametrize(
    "filter_", ["pmb", "particle-phd", "gm-phd", "particle-cphd", "gm-cphd", "none"]
)
@pytest.mark.parametrize("order", [1, -1])
def test_the_ground_plane_brings_what_fits_it(filter_: str, order: int):
    """Its parts, seconds, in whatever order it is asked for."""
    sets = ["motion.kind=plane", "camera.region=[-10, 0, 10, 40]", f"filter.kind={filter_}"][
        ::order
    ]
    settings = config.load(sets=sets)
    stages = config.build(settings, SequenceInfo(640, 480, 10.0))
    model = stages.model
    assert (type(model.motion), type(model.sensor), type(model.birth)) == (
        PlaneMotion,
        PlaneSensor,
        PlaneBirth,
    )
    assert (model.rate, model.first) == (1.0, 0.1)
    assert (
        model.motion.borders
        == model.sensor.borders
        == model.birth.borders
        == (-10.0, 0.0, 10.0, 40.0)
    )
    assert type(model.clutter) is PlaneClutter
    if filter_ != "pmb":
        assert settings.as_dict()["associate"]["gap_cost"] == 1.609
    # What was asked for stays, also over a filter named later.
    linked = [*sets, "associate.kind=graph", "time.units_per_second=2", "associate.gap_cost=0.3"]
    mine = config.overlay(config.load(sets=linked), {"filter": {"kind": "gm-phd"}})
    assert (
        mine.as_dict()["time"]["units_per_second"],
        mine.as_dict()["associate"]["gap_cost"],
    ) == (2.0, 0.3)


def test_on_the_ground_a_uniform_density_needs_a_region():
    def model(*sets: str):
        return config.build(config.load(sets=["motion.kind=plane", *sets]), INFO).model

    with pytest.raises(InputError, match="region"):
        model("clutter.clutter_per_frame=0.3")
    births = model("birth.births_per_second=0.25")
    with pytest.raises(InputError, match="region"):
        births.birth.gaussians(np.ones((5, 1)), births.sensor, 1.0)
    clutter = model("camera.region=[-10, 0, 10, 40]", "clutter.clutter_per_frame=0.3").clutter
    np.testing.assert_allclose(clutter.intensity(np.zeros((5, 1))), 0.3 / 800)
    np.testing.assert_array_equal(
        model("clutter.density=1e-4").clutter.intensity(np.zeros((5, 3))), 1e-4
    )


@pytest.mark.parametrize("place", ["[1, 2, -1, 1, 1]", "[1, 2, 1, 0, 1]", "[1, 2, 1, 1, nan]"])
def test_places_that_are_none_are_told(place: str):
    for where in ("birth.kind=places", f"birth.places=[{place}]"), (f"filter.initial=[{place}]",):
        with pytest.raises(InputError, match="places"):
            config.build(
                config.load(sets=["motion.kind=plane", "clutter.density=0.1", *where]), INFO
            )


def test_the_region_is_what_the_camera_shows(data):
    """PETS 2009, view 1: the walkway lies within; beyond ``far`` nothing counts."""

    def model(*sets: str):
        camera = f"camera.file='{data / 'pets2009' / 'View_001.xml'}'"
        return config.build(
            config.load(sets=[camera, *sets], preset="e13"), SequenceInfo(768, 576, 7.0)
        ).model

    assert model().motion.borders == (0.0, 0.0, 0.0, 0.0), "E13's targets survive everywhere alike"
    left, low, right, high = model().sensor.borders
    assert left < -15 < 10 < right
    assert low < -15 < 5 < high
    assert model("camera.max_distance=25").sensor.borders[3] < high
    assert model("sensor.view=true").motion.borders == (left, low, right, high)


def test_a_filter_that_labels_targets_brings_their_identities():
    """Unless another association was chosen; what both kinds of association know is kept."""
    settings = config.load(sets=["associate.output_delay=3", "filter.kind=mht"])
    stages = config.build(settings, INFO)
    assert (type(stages.filter), type(stages.extractor)) == (MHT, BestHypothesis)
    assert stages.associator == Labelled(output_delay=3, max_coast=0.2, coast_by_evidence=False)
    graph = config.load(sets=["filter.kind=mht", "associate.kind=graph", "associate.back_dating=1"])
    assert config.build(graph, INFO).associator == GraphMatching(back_dating=1)
    assert config.build(settings, INFO, "particle-phd").associator == GraphMatching(output_delay=3)


def test_m09s_rival_has_its_printed_parameters():
    stages = config.build(config.load(preset="m09-mht"), SequenceInfo(360, 288, 25.0))
    model = stages.model
    z = np.array([[100.0], [80], [20], [40]])
    np.testing.assert_allclose(
        np.diag(model.sensor.covariance(z, model.sensor.states(z)[0])[0]), [3, 3, 6, 6]
    )
    state, info = stages.filter.step(stages.filter.start(model, None), z, model, 1.0, None)
    # Of 0.0025 new targets and 0.00007 false alarms.
    assert info.clutter_probability[0] == pytest.approx(0.00007 / 0.00257)
    assert state.mass == pytest.approx(0.0025 / 0.00257)
    assert (info.clutter + info.evidence)[0] == pytest.approx(0.00257 / (360 * 288))
    with pytest.raises(InputError, match=r"^filter\.new_target_density: .* frame's size, not 0x0"):
        MHT(new_target_density=0.1).step(state, z, model, 1.0, None)
