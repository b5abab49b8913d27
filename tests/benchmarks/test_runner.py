"""The benchmark's runner: what it writes, and that a part which fails or is skipped does not stop
the others.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks import c_kernel, d14, mht, particle_phd
from benchmarks.__main__ import main, measure
from benchmarks.parts import SMOKE, Outcome, Part, Row, Skipped
from benchmarks.registry import PARTS
from benchmarks.report import Paper
from benchmarks.timing import Spread, exponent, in_turns

REQUIRED = {
    "particle_phd_ms",
    "gm_phd_us",
    "growth_exponent",
    "ratio_gated_numpy",
    "ratio_dense_numpy",
    "ratio_stonesoup_gm",
    "ratio_stonesoup_smc",
    "tracker_ms",
    "bytes_per_particle",
    "d14_seconds",
    "mht_ms",
    "pmbm_ms",
}


def paper() -> tuple[Paper, Console]:
    console = Console(record=True, width=160, quiet=True)
    return Paper(console), console


def test_the_parts_make_every_required_entry() -> None:
    assert {key for part in PARTS for key in part.keys} >= REQUIRED
    assert len({part.name for part in PARTS}) == len(PARTS)


def test_a_failed_part_leaves_its_reason_and_others_go_on(tmp_path: Path) -> None:
    def broken(scale: object, say: object) -> Outcome:
        raise RuntimeError("no such luck")

    def skipped(scale: object, say: object) -> Outcome:
        raise Skipped("no compiler")

    def fine(scale: object, say: object) -> Outcome:
        rows = (
            Row("slow", 2.0, "×", most=1.0),
            Row("fast", 2.0, "×", least=1.0),
            Row("free", float("nan"), ""),
        )
        return Outcome(rows, {"answer": float("nan"), "array": np.float64(3)})

    parts = [
        Part("broken", "B", broken, ("lost",)),
        Part("skipped", "S", skipped, ("missing",)),
        Part("fine", "F", fine, ("answer",)),
    ]
    sheet, _ = paper()
    measure(parts, SMOKE, tmp_path / "out" / "bench.json", sheet)
    document = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert document["parts"]["broken"]["status"] == "failed"
    assert document["parts"]["broken"]["reason"] == "RuntimeError: no such luck"
    assert document["parts"]["skipped"] | {"seconds": 0} == {
        "status": "skipped",
        "reason": "no compiler",
        "seconds": 0,
        "rows": [],
    }
    assert [row["kept"] for row in document["parts"]["fine"]["rows"]] == [False, True, None]
    assert document["lost"] is None
    assert document["missing"] is None
    assert document["answer"] is None
    assert document["array"] == 3.0
    assert document["machine"]["cores"] >= 1
    assert document["versions"]["numpy"] == np.__version__
    assert document["seeds"] == [1]


@pytest.mark.parametrize("unit", ["s", "ms", "µs", "frames/s"])
def test_a_time_has_no_limit(unit: str) -> None:
    assert Row("a time", 2.0, unit).kept is None
    for limit in ({"most": 1.0}, {"least": 1.0}):
        with pytest.raises(ValueError, match=f"a time: expected a ratio for a limit, got {unit}"):
            Row("a time", 2.0, unit, **limit)


def test_the_quick_run_has_the_parts_with_ratios_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ran(*arguments: str) -> list[str]:
        out = tmp_path / "bench.json"
        assert main([*arguments, "--out", str(out)]) == 0
        return list(json.loads(out.read_text())["parts"])

    def nothing(scale: object, say: object) -> Outcome:
        return Outcome(())

    idle = tuple(replace(part, run=nothing) for part in PARTS)
    monkeypatch.setattr("benchmarks.__main__.PARTS", idle)
    assert ran() == ["numpy-twins", "c-kernel", "tracker", "command"]
    assert ran("--full") == [part.name for part in PARTS]
    assert ran("--only", "mht") == ["mht"]


def test_the_table_has_every_part_and_its_reason() -> None:
    sheet, console = paper()
    sheet.part(
        "Some part",
        (Row("a value", 12.5, "MiB", Spread.of([12.0, 12.5, 13.0]), most=20.0, note="n [b]"),),
    )
    sheet.part("Other part", (), "skipped: no compiler [cc]")
    console.quiet = False
    with console.capture() as caught:
        sheet.show()
    text = caught.get()
    for word in (
        "Some part",
        "12.5 MiB",
        "12.2 … 12.8",
        "≤ 20",
        "yes",
        "n [b]",
        "Other part",
        "no compiler [cc]",
    ):
        assert word in text


def test_the_particle_part_measures_all_sizes_and_forms() -> None:
    entries = particle_phd.run(SMOKE, lambda text: None).entries
    assert set(entries["particle_phd_ms"]) == {"2", "4"}
    assert all(ms > 0 for ms in entries["particle_phd_ms"].values())
    assert {(d["targets"], d["form"]) for d in entries["particle_phd"]} == {
        (n, form) for n in (2, 4) for form in ("worst", "specified")
    }
    worst = {d["targets"]: d["pairs"] for d in entries["particle_phd"] if d["form"] == "worst"}
    assert worst[4] > worst[2] > 0


@pytest.mark.slow
def test_d14s_sequence_is_timed_with_its_filters() -> None:
    outcome = d14.run(SMOKE, lambda text: None)
    assert set(outcome.entries["d14_seconds"]) == {"mcmc", "mcmc_each", "particle-phd"}
    assert all(row.value > 0 for row in outcome.rows)
    assert all(row.cpu is not None and row.cpu > 0 for row in outcome.rows)


def test_multiple_hypotheses_are_timed_and_counted() -> None:
    outcome = mht.run(SMOKE, lambda text: None)
    assert len(outcome.rows) == 4
    assert all(row.cpu is not None and row.cpu > 0 for row in outcome.rows)
    for kind in ("mht", "pmbm"):
        few = outcome.entries[kind]["10"]
        many = outcome.entries[kind]["50"]
        assert all(0 < few[name] < many[name] for name in ("leaves", "nodes", "hypotheses"))


def test_c_and_numba_agree_on_the_kernel() -> None:
    try:
        outcome = c_kernel.run(SMOKE, lambda text: None)
    except Skipped as reason:
        pytest.skip(str(reason))
    assert outcome.entries["c_kernel"]["ratio"] > 0
    # A library linked with -ffast-math would have switched denormal numbers off for everything that
    # comes after.
    assert np.float64(5e-324) * np.float64(1.0) > 0


def test_exponent_and_turns() -> None:
    assert exponent([10, 100, 1000], [2, 20, 200]) == pytest.approx(1.0)
    assert exponent([1, 2, 4], [3, 12, 48]) == pytest.approx(2.0)
    assert np.isnan(exponent([1], [1]))
    order: list[str] = []
    times = in_turns([lambda: order.append("a"), lambda: order.append("b")], repeats=2, warm_up=1)
    assert order == ["a", "b"] * 3
    assert [len(t) for t in times] == [2, 2]
