"""The types of the settings for type checkers are those of the settings."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import get_args, get_type_hints

import pytest

from phdtrack import Tracker, config
from phdtrack.config import section_types
from phdtrack.config.presets import PRESETS
from phdtrack.config.registry import SECTIONS, constructor_defaults, settable
from phdtrack.detect import DETECTORS, detector_parameters
from phdtrack.detect.embedding_settings import EmbeddingSettings
from scripts_of_project import ROOT, script_named

# The class of a section, and the alias of its kinds.
NAMES = {section: section.title().replace("_", "") for section in SECTIONS}


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return script_named("section_types")


def test_the_committed_files_are_current(
    script: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert script.main(["--check"]) == 0, capsys.readouterr().err


def test_a_stale_file_fails_the_check(
    script: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(script, "MODULE", tmp_path / "types.py")
    monkeypatch.setattr(script, "PAGE", tmp_path / "settings.md")
    assert script.main([]) == 0
    assert script.main(["--check"]) == 0
    (tmp_path / "types.py").write_text("")
    assert script.main(["--check"]) == 1
    assert "types.py is out of date: run `make docs`" in capsys.readouterr().err


@pytest.mark.parametrize("section", sorted({*SECTIONS} - {"detector", "embedding"}))
def test_every_setting_has_a_type(section: str) -> None:
    typed = getattr(section_types, f"{NAMES[section]}Section")
    kinds = SECTIONS[section]
    names = {name for kind in kinds for name in settable(section, kind)}
    if len(kinds) > 1:
        names.add("kind")
        assert get_args(getattr(section_types, f"{NAMES[section]}Kind")) == kinds
    assert set(get_type_hints(typed)) == names
    assert not typed.__required_keys__


def test_every_parameter_of_detectors_and_networks_has_a_type() -> None:
    names = {name for one in (*DETECTORS, "onnx:any") for name in detector_parameters(one)}
    assert set(get_type_hints(section_types.DetectorSection)) == names
    networks = {field.name for field in fields(EmbeddingSettings)}
    assert set(get_type_hints(section_types.EmbeddingSection)) == networks


def test_presets_and_sections_are_complete() -> None:
    assert get_args(section_types.PresetName) == PRESETS
    sections = set(get_type_hints(section_types.Sections))
    assert sections == set(SECTIONS)
    # The filter is an argument of its own; boxes and embeddings come from the caller.
    of_tracker = set(get_type_hints(section_types.TrackerSections))
    assert sections - of_tracker == {"filter", "detector", "embedding"}


@pytest.mark.parametrize("kind", SECTIONS["filter"])
def test_every_filter_that_has_a_type_can_be_chosen(kind: str) -> None:
    assert kind in get_args(section_types.FilterKind)
    assert Tracker((640, 480), filter=kind).stages.filter is not None


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_that_has_a_type_can_be_chosen(preset: str) -> None:
    assert preset in get_args(section_types.PresetName)
    assert config.load(preset=preset).preset == preset


def test_page_lists_every_setting() -> None:
    page = (ROOT / "docs" / "api" / "settings.md").read_text(encoding="utf-8")
    parts = dict(part.split("\n", 1) for part in page.split("\n## ")[1:])
    for section, kinds in SECTIONS.items():
        for kind in kinds:
            defaults = constructor_defaults(section, kind)
            for name in settable(section, kind):
                rows = [row for row in parts[section].splitlines() if f"| `{name}` |" in row]
                assert any(kind in row for row in rows), (section, kind, name)
                if defaults.get(name) is True:
                    assert any("| bool | `true` |" in row for row in rows), (section, name)
    assert all(f"`{preset}`" in parts["Presets"] for preset in PRESETS)
