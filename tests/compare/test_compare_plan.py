"""From words to a plan: which sets a sequence has, which settings stand for which filter, and every
mistake beforehand.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from compare_cases import FRAMES, planned, sequence, small

from phdtrack.errors import InputError


def test_every_combination_has_a_place_of_its_own(tmp_path: Path) -> None:
    made = small(tmp_path, clutter=[0.0, 2.5], seeds=3, variants=["few=filter.max_components=20"])
    assert [case.name for case in made.cases] == ["a det", "b det"]
    assert [method.name for method in made.methods] == ["gm-phd", "none", "few"]
    assert len(made.runs) == 2 * 2 * 3 * 3
    assert len({run.place for run in made.runs}) == len(made.runs)
    assert made.runs[-1].place == Path("runs/b/det/clutter-2.5/few/seed-3")


def test_a_folder_has_all_its_sets_and_its_name_decides(tmp_path: Path) -> None:
    folder = str(sequence(tmp_path / "yard", sets=("det_public", "det_frcnn", "detour")))
    assert [case.name for case in planned([folder]).cases] == ["yard frcnn", "yard public"]
    chosen = planned(
        [folder],
        detections=["public", f"mine={folder}/detour/det.txt", f"{folder}/../{{}}/detour/det.txt"],
    )
    assert [case.detections for case in chosen.cases] == ["public", "mine", "det"]
    files = [case.file.resolve() for case in chosen.cases if case.file is not None]
    assert files[1] == files[2] == (tmp_path / "yard" / "detour" / "det.txt")
    assert chosen.cases[0].info.frames == FRAMES


def test_a_setting_stands_for_the_filters_that_have_it(tmp_path: Path) -> None:
    made = small(
        tmp_path,
        filters=["particle-phd", "gm-phd", "none"],
        sets=["filter.particles_per_target=77", "sensor.detection_probability=0.7"],
    )
    settings = {method.name: method.settings.as_dict() for method in made.methods}
    assert settings["particle-phd"]["filter"]["particles_per_target"] == 77  # type: ignore[index]
    assert "particles_per_target" not in settings["gm-phd"]["filter"]  # type: ignore[operator]
    assert all(values["sensor"]["detection_probability"] == 0.7 for values in settings.values())  # type: ignore[index]


def test_variants_start_from_the_first_filter_or_from_a_preset(tmp_path: Path) -> None:
    made = small(
        tmp_path,
        sets=["filter.max_components=50"],
        variants=[
            "few=filter.max_components=20,sensor.detection_probability=0.8",
            "paper=preset=m09",
            "other=filter.kind=gm-cphd",
        ],
    )
    few, paper, other = (method.settings.as_dict() for method in made.methods[2:])
    assert (few["filter"]["kind"], few["filter"]["max_components"]) == ("gm-phd", 20)  # type: ignore[index]
    assert few["sensor"]["detection_probability"] == 0.8  # type: ignore[index]
    assert (paper["preset"], paper["filter"]["kind"]) == ("m09", "particle-phd")  # type: ignore[index]
    assert other["filter"]["kind"] == "gm-cphd"  # type: ignore[index]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"filters": ["gm"]}, "--filters: unknown kind of filter: gm"),
        (
            {"sets": ["filter.particles_per_target=5"]},
            "unknown setting of [filter]: particles_per_target",
        ),
        ({"sets": ["filter.kind=none"]}, "--filters already names"),
        ({"sets": ["sensor.detection_probability=7"]}, "sensor.detection_probability"),
        ({"variants": ["few"]}, "--variant few"),
        ({"variants": ["few=filter.particles_per_target=5"]}, "--variant few"),
        ({"variants": ["none=filter.max_components=5"]}, "twice"),
        ({"detections": ["public"]}, "no detections called public. There are det"),
        ({"detections": ["/nowhere/det.txt"]}, "cannot belong to 2 sequences"),
        ({"detections": ["/nowhere/{}.txt"]}, "/nowhere/a.txt"),
        ({"truth": "/nowhere/{}.txt"}, "/nowhere/a.txt"),
        ({"detectors": ["change"]}, "no pictures"),
        ({"detectors": ["chang"]}, "Did you mean change"),
        ({"clutter": [-1.0]}, "--clutter"),
        ({"iou": 2.0}, "iou"),
    ],
)
def test_mistakes_are_told_before_anything_runs(
    tmp_path: Path, more: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        small(tmp_path, **more)


def test_malformed_files_are_told(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "a")
    with (folder / "gt" / "gt.txt").open("a") as file:
        file.write("31,1,x,1,1,1,1,-1,-1,-1\n")
    with pytest.raises(InputError, match=r"gt/gt.txt, line \d+"):
        planned([str(folder)])
    (sequence(tmp_path / "b") / "seqinfo.ini").unlink()
    with pytest.raises(InputError, match="size and rate"):
        planned([str(tmp_path / "b")])
