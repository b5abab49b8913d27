"""The rows of a summary against the same numbers by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest
from compare_cases import small

from phdtrack.compare import Comparison, over_sequences, run, summary
from phdtrack.compare.results import Results
from phdtrack.compare.runs import ComparedRun
from phdtrack.compare.statistics import Row, interval
from phdtrack.metrics import Scores, pool
from phdtrack.parallel import Failed
from phdtrack.report import About


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    folder = tmp_path_factory.mktemp("summary")
    made = small(
        folder,
        filters=["particle-phd", "none"],
        clutter=[0.0, 3.0],
        seeds=3,
        sets=["filter.particles_per_target=60"],
    )
    return run(made, folder / "out")


def row(found: Sequence[Row], sequence: str, rate: float, method: str) -> Row:
    (one,) = [r for r in found if (r.sequence, r.clutter, r.filter) == (sequence, rate, method)]
    return one


def scores(comparison: Comparison, rate: float, method: str, seed: int) -> list[Scores]:
    runs = [
        run
        for run in comparison.plan.runs
        if (run.rate, run.method.name, run.seed) == (rate, method, seed)
    ]
    found = [comparison.result(run) for run in runs]
    return [one.scores for one in found if isinstance(one, ComparedRun) and one.scores is not None]


def test_pooled_rows_add_up_the_sums_seed_by_seed(comparison: Comparison) -> None:
    found = summary(comparison)
    for method in ("particle-phd", "none"):
        pools = [pool(scores(comparison, 3.0, method, seed)) for seed in (1, 2, 3)]
        one = row(found, "all", 3.0, method)
        assert (one.cases, one.detections, one.random) == (2, "det", True)
        for name in ("MOTA", "IDF1", "HOTA", "id_switches"):
            assert one.scores[name] == interval([float(getattr(each, name)) for each in pools])


def test_differences_are_paired_by_seed(comparison: Comparison) -> None:
    found = summary(comparison)
    mine, theirs = (
        [scores(comparison, 3.0, name, seed)[0].MOTA for seed in (1, 2, 3)]
        for name in ("none", "particle-phd")
    )
    assert row(found, "a", 3.0, "none").ahead["MOTA"] == interval(
        [a - b for a, b in zip(mine, theirs, strict=True)]
    )
    assert row(found, "a", 3.0, "particle-phd").ahead == {}
    # One run of none beside three of the filter: the difference is random by one side alone.
    still = row(found, "a", 0.0, "none")
    assert (still.random, still.scores["MOTA"].seeds, still.ahead["MOTA"].seeds) == (False, 1, 3)


def test_a_failed_run_leaves_its_rows_empty(comparison: Comparison) -> None:
    run_of_none = next(
        one for one in comparison.plan.runs if one.method.name == "none" and one.rate == 3.0
    )
    results = {**comparison.results, run_of_none.place: Failed("no luck")}
    broken = Comparison(comparison.plan, comparison.folder, results)
    found = summary(broken)
    for sequence in ("a", "all"):
        one = row(found, sequence, 3.0, "none")
        assert (one.scores, one.failed) == ({}, "no luck")
    assert row(found, "b", 3.0, "none").scores
    (line,) = Results.of(broken, ("MOTA", "ms")).table([row(found, "a", 3.0, "none")]).rows
    assert line == ("a", "det", "3", "none", "failed", "")


def test_intervals_over_sequences_are_of_the_means_of_each(comparison: Comparison) -> None:
    found = summary(comparison)
    means = over_sequences(found)
    assert {(one.sequence, one.detections, one.cases) for one in means} == {("mean", "det", 2)}
    for method in ("particle-phd", "none"):
        one = row(means, "mean", 3.0, method)
        each = [row(found, name, 3.0, method).scores["MOTA"].mean for name in ("a", "b")]
        assert one.scores["MOTA"] == interval(each)
        assert [values["MOTA"] for values in one.each] == each
    ahead = [row(found, name, 3.0, "none").ahead["MOTA"].mean for name in ("a", "b")]
    assert row(means, "mean", 3.0, "none").ahead["MOTA"] == interval(ahead)
    assert row(means, "mean", 3.0, "particle-phd").ahead == {}
    results = Results.of(comparison, ("MOTA",))
    assert all("±" in line[4] for line in results.table(results.means).rows)
    assert "Mean over the sequences" in results.page(About("t", "c"))
    assert "No interval over sequences" not in " ".join(results.notes(in_turn=True))
    # One sequence says nothing of others.
    alone = [one for one in found if one.sequence == "a"]
    assert over_sequences(alone) == ()
    assert "No interval over sequences" in " ".join(
        Results(comparison, alone, ("MOTA",)).notes(in_turn=True)
    )


def test_numbers_as_people_read_them(comparison: Comparison) -> None:
    assert f"{interval([0.5, 0.6]):.3f}" == "0.550 ± 0.635"
    assert f"{interval([0.25]):+.3f}" == "+0.250"
    assert f"{interval([]):.3f}" == "–"
    rows = [
        Row("a", detections, 1, 0.0, method)
        for detections, method in (("x", "f"), ("x", "g"), ("y", "f"))
    ]
    lines = Results(comparison, rows, ("ms",)).table(rows).rows
    assert lines == [("a", "x", "0", "f", "–"), ("", "", "", "g", "–"), ("", "y", "0", "f", "–")]


def made_up(method: str, values: list[float], random: bool = True) -> Row:
    """One method's MOTA at each seed."""
    own = {"MOTA": interval(values if random else values[:1])}
    return Row(
        "a",
        "det",
        1,
        0.0,
        method,
        random,
        scores=own,
        each=tuple({"MOTA": value} for value in values),
    )


def test_a_best_is_named_only_where_it_is_more_than_chance(comparison: Comparison) -> None:
    still = replace(comparison, plan=replace(comparison.plan, rates=(0.0,)))
    a = made_up("a", [0.50, 0.60, 0.40])
    b = made_up("b", [0.51, 0.59, 0.41])
    # Far less than the seeds scatter, but the same at every one.
    c = made_up("c", [0.49, 0.57, 0.39])
    d = made_up("d", [0.1, 0.1, 0.1], random=False)
    (said,) = Results(still, (c, a, b, d), ()).sentences()
    assert said.startswith("Without added clutter b 0.503 ± ")
    assert " has the highest MOTA, not significantly above a 0.500 ± " in said
    assert said.index("; c 0.483 ± ") > said.index("above a")
    assert said.endswith(", d 0.100.")
    (said,) = Results(still, (c, b), ()).sentences()
    assert said.startswith("Without added clutter b 0.503 ± ")
    assert "not significantly" not in said
    e = made_up("e", [0.2, 0.2, 0.2], random=False)
    assert Results(still, (d, e), ()).sentences() == (
        "Without added clutter e 0.200 has the highest MOTA; d 0.100.",
    )
    # One seed tells nothing from chance.
    assert (
        "not significantly above"
        in Results(still, (made_up("f", [0.5]), made_up("g", [0.9])), ()).sentences()[0]
    )


def test_the_best_of_a_column_has_a_star_and_what_is_as_good_too(comparison: Comparison) -> None:
    names = ("MOTA", "id_switches", "frames")
    values = {"a": (0.5001, 3, 9), "b": (0.5004, 1, 8), "c": (0.4, 1, 7)}
    scores = {
        method: dict(zip(names, map(float, each), strict=True)) for method, each in values.items()
    }
    still = [
        Row(
            "x",
            "det",
            1,
            0.0,
            method,
            scores={name: interval([value]) for name, value in each.items()},
            each=(each,),
        )
        for method, each in scores.items()
    ]
    table = Results(comparison, still, names).table(still)
    # What differs by less than is shown is as good; of the number of frames none is better.
    assert [line[4:] for line in table.rows] == [
        ("*0.500", "3.0", "9.000"),
        ("*0.500", "*1.0", "8.000"),
        ("0.400", "*1.0", "7.000"),
    ]
    # One run's time is no measure, however often it stands for all seeds.
    timed = [
        Row("x", "det", 1, 0.0, name, scores={"ms": interval([ms])}, each=({"ms": ms},) * 3)
        for name, ms in (("a", 1.0), ("b", 2.0))
    ]
    assert [line[4] for line in Results(comparison, timed, ("ms",)).table(timed).rows] == [
        "1.00",
        "2.00",
    ]
    # Of random methods those are as good that the seeds do not tell apart; one alone is no best.
    many = [
        made_up("a", [0.50, 0.60, 0.40]),
        made_up("b", [0.51, 0.59, 0.41]),
        made_up("c", [0.49, 0.57, 0.39]),
    ]
    found = Results(comparison, (), ("MOTA",))
    assert [line[4][:5] for line in found.table(many).rows] == ["*0.50", "*0.50", "0.483"]
    assert found.table(many[:1]).rows[0][4].startswith("0.500")


def test_intervals_are_those_of_a_printed_table() -> None:
    found = interval([1.0, 3.0])
    # s = √2, s / √2 = 1, t(1 degree of freedom, 97.5 %) = 12.706.
    assert (found.mean, found.half, found.clear) == (2, pytest.approx(12.706, abs=1e-3), False)
    assert interval([0.7]).mean == 0.7
    assert math.isnan(interval([0.7]).half)
    assert math.isnan(interval([]).mean)
