"""Kinds of filters and extractions: which one wins, what it brings along, and what does not go together."""

from __future__ import annotations

import pytest

from phdtrack import config
from phdtrack.errors import InputError
from phdtrack.extract import Components, CountedComponents, CountedKMeans, KMeans, Raw
from phdtrack.filters import GMCPHD, GMPHD, NoFilter, ParticleCPHD, ParticlePHD
from phdtrack.presets import PRESETS
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)


@pytest.mark.parametrize(("configured", "named", "kind"), [
    ("none", "", NoFilter), ("particle-phd", "", ParticlePHD),
    ("none", "particle-phd", ParticlePHD), ("particle-phd", "none", NoFilter),
    ("gm-phd", "", GMPHD), ("none", "gm-phd", GMPHD), ("particle-phd", "gm-phd", GMPHD), ("gm-phd", "none", NoFilter),
    ("gm-phd", "particle-phd", ParticlePHD),
    ("gm-cphd", "", GMCPHD), ("particle-phd", "gm-cphd", GMCPHD), ("gm-cphd", "gm-phd", GMPHD),
    ("particle-cphd", "", ParticleCPHD), ("gm-cphd", "particle-cphd", ParticleCPHD), ("particle-cphd", "none", NoFilter),
])  # fmt: skip
def test_a_named_filter_wins(configured: str, named: str, kind: type):
    stages = config.build(config.load(sets=[f"filter.kind={configured}"]), INFO, named)
    assert isinstance(stages.filter, kind)
    extractors = {
        NoFilter: Raw, ParticlePHD: KMeans, GMPHD: Components, ParticleCPHD: CountedKMeans, GMCPHD: CountedComponents
    }  # fmt: skip
    assert isinstance(stages.extractor, extractors[kind])


@pytest.mark.parametrize("preset", PRESETS)
def test_a_filter_brings_an_extraction_that_fits_it(preset: str, tmp_path):
    """By option, by a file and by name; what both kinds of extraction have stays."""
    path = tmp_path / "mine.toml"
    path.write_text("[extract]\noverlap = 0.7\n[filter]\nkind = 'gm-phd'\n", encoding="utf-8")
    for settings, overlap in (
        (config.load(sets=["extract.overlap=0.3", "filter.kind=gm-phd"], preset=preset), 0.3),
        (config.load(path, preset=preset), 0.7),
        (config.overlay(config.load(preset=preset), {"extract": {"overlap": 0.6}, "filter": {"kind": "gm-phd"}}), 0.6),
    ):
        assert settings.as_dict()["extract"] == {**settings.as_dict()["extract"], "kind": "components", "overlap": overlap}
    assert isinstance(config.build(config.load(preset=preset), INFO, "gm-phd").extractor, Components)


@pytest.mark.parametrize(("sets", "says"), [
    (["filter.kind=gm-phd", "extract.kind=kmeans"], "use components"),
    (["extract.kind=mixture", "filter.kind=gm-phd"], "use components"),
    (["extract.kind=components"], "kmeans or mixture"),
    (["filter.kind=gm-phd", "birth.kind=uniform"], "birth.kind=measurement"),
    (["filter.kind=gm-phd", "spawn.kind=split"], "spawn.kind=none"),
    (["filter.kind=gm-cphd", "birth.kind=uniform"], "birth.kind=measurement"),
    (["filter.kind=particle-cphd", "spawn.kind=split"], "spawn.kind=none"),
    (["filter.kind=particle-cphd", "extract.kind=kmeans"], "use counted-kmeans"),
])  # fmt: skip
def test_kinds_that_do_not_go_together(sets: list[str], says: str):
    with pytest.raises(InputError, match=says):
        config.load(sets=sets)
