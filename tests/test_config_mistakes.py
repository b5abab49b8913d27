"""Mistakes in settings: each names its place and the nearest name."""

from __future__ import annotations

import pytest

from phdtrack import config
from phdtrack.errors import InputError
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)


MISTAKES = [
    ("sensor.detection_probabilty=0.9", "Did you mean detection_probability?"),
    ("sensr.detection=0.9", "Did you mean sensor?"),
    ("birth.kind=unifrom", "Did you mean uniform?"),
    ("filter.kind=particle", "particle-phd"),
    ("time.kind=box", "one kind only"),
    ("motion.frame_size=[1, 2]", "unknown setting"),
    ("sensor.detection_probability=1.5", "less than or equal to 1"),
    ("sensor.detection_probability=-0.1", "greater than or equal to 0"),
    ("sensor.detection_probability=nan", "sensor.detection_probability"),
    ("sensor.detection_probability=true", "valid number"),
    ("sensor.detection_probability='0.9'", "valid number"),
    ("sensor.detection_probability=high", "valid number"),
    ("sensor.detection_probability=", "valid number"),
    ("sensor.scaling=partical", "'particle'"),
    ("sensor.fixed_noise=[1, 2, 3]", "at most 2"),
    ("motion.acceleration=-1", "greater than or equal to 0"),
    ("motion.scaled_noise=maybe", "valid boolean"),
    ("associate.max_coast=-1", "greater than or equal to 0"),
    (
        "associate.back_dating=2",
        "It goes with associate.kind=graph or detections; here there are",
    ),
    ("associate.min_track_length=2.5", "valid integer"),
    ("associate.min_track_length=0", "greater than or equal to 1"),
    ("filter.gate_probability=0", "greater than 0"),
    ("filter.max_hypotheses=0", "greater than or equal to 1"),
    (
        "filter.particles_per_target=500",
        (
            "It goes with filter.kind=particle-phd or particle-cphd; here there are"
            " hypothesis_threshold"
        ),
    ),
    ("clutter.clutter_per_frame=-1", "greater than or equal to 0"),
    ("time.units_per_second=0", "greater than 0"),
]


@pytest.mark.parametrize(("option", "says"), MISTAKES)
def test_mistakes_in_options(option: str, says: str):
    with pytest.raises(InputError) as error:
        config.load(sets=["motion.survival_probability=0.98", option])
    assert says in str(error.value)
    assert str(error.value).startswith(f"--set {option}: ")


@pytest.mark.parametrize(
    "option",
    [
        "sensor.detection_probability",
        "sensor=3",
        "detection=0.9",
        "sensor.=1",
        "",
        "=",
        "preset=m09",
    ],
)
def test_options_have_a_section_a_name_and_a_value(option: str):
    with pytest.raises(InputError, match=r"section\.name=value"):
        config.load(sets=[option])


@pytest.mark.parametrize(("text", "says"), [
    ("[sensor\ndetection = 0.9", "line 1"),
    ("[sensor]\ndetection = 0.9\n\nspread = = 2", "line 4"),
    ("[sensor]\ndetection = .9", "line 2"),
    ("[sensor]\ndetection = 0.9\ndetection = 0.8\nspread = 1\n", "line 3"),
    ("sensor = 3", "section [sensor]"),
    ("[[sensor]]\ndetection = 0.9", "section [sensor]"),
    ('preset = "m08"', "preset"),
    ("preset = 9", "preset"),
    ('preset = ["m09"]', "preset"),
    ('[birth]\nkind = ["uniform"]', "kind of birth"),
    ("[birth]\nkind = 3", "kind of birth"),
    ('[camera_motion]\nkind = "file"', "needs a value for file"),
    ("[filter]\ninitial = [[1, 2, 1, 1, 1]]", "places on the ground"),
    ("[tracker]\nx = 1", "section"),
    ("x = 1", "section"),
])  # fmt: skip
def test_files_that_are_no_settings(text: str, says: str, tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        config.load(path)
    assert says in str(error.value)
    assert str(path) in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b'[sensor]\nkind = "caf\xe9"\n')
    for path in (tmp_path / "nowhere.toml", tmp_path, tmp_path / "latin.toml"):
        with pytest.raises(InputError) as error:
            config.load(path)
        assert str(path) in str(error.value)


@pytest.mark.parametrize("values", [0.9, "detection", [("detection", 0.9)], None])
def test_sections_laid_over_must_be_sections(values):
    with pytest.raises(InputError, match="section"):
        config.overlay(config.load(), {"sensor": values})


def test_settings_of_the_detector_go_through_unchecked(tmp_path):
    """They depend on the detector, which checks them itself."""
    path = tmp_path / "settings.toml"
    path.write_text("[detector]\nthreshold = 12\n", encoding="utf-8")
    assert config.load(path, ["detector.mask=a.png"]).values("detector") == {
        "threshold": 12,
        "mask": "a.png",
    }
    assert config.load().values("detector") == {}
