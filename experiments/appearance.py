"""What appearance is worth: real sequences with embeddings made from the truth, against four peers
with the same ones; embeddings that say nothing or the wrong thing; real pictures; a simulation of
people who come back; and the cost.

The page has parts, which can be made one at a time: ``python -m experiments appearance --only
PART``. The part ``videos`` takes minutes and is made only if it is asked for. The peers' scores are
kept in `experiments/appearance_peers.csv`; without that file they run in their environment
(`experiments.appearance_peers` says which).
"""

from __future__ import annotations

import csv
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from experiments import appearance_cost, appearance_pictures, appearance_returns
from experiments.appearance_inputs import PEERS, PEERS_SEEDS, QUALITIES
from experiments.appearance_runs import HARMFUL, NONE, LookRun, track
from experiments.cameras import SCORES, Row, keep, scored
from experiments.common import (
    BOXMOT_PYTHON,
    ROOT,
    Options,
    filled,
    in_parallel,
    need_data,
    run_peers,
    table,
    with_error,
    write_parts,
)
from experiments.degraded import all_cases
from experiments.degraded_inputs import OLD_GROUP, CameraCase
from phdtrack.formats import read_tracks
from phdtrack.types import F8

OUTPUTS = ("online", "corrected")
SEEDS = 3
# What IDF1 should gain online, in points, and the share of pairs in which we should be ahead.
GOALS = {"weak": 2.0, "middle": 5.0, "strong": 7.0}
AHEAD = 0.75
# Points of IDF1 and HOTA that embeddings without any use may cost.
HARM = 0.3
# One short sequence of some groups, for the short form.
SHORT = ("KITTI-0014-car", "TUD-Campus")
CSV = Path(__file__).with_name("appearance_peers.csv")
PEERS_TRACKS = ROOT / "runs" / "appearance-peers"
# Scores closer than this are equal: the kept ones have three digits.
TIE = 0.0006
# Pairs far behind that are listed.
LISTED = 12


@dataclass(slots=True)
class LookRuns:
    """The scores of all cases with some kinds of embeddings, tracked when they are first needed.

    Attributes
    ----------
    of : the cases.
    options : of the experiment.
    rows : by kind, seed and output, the rows of `cameras.scored`.
    """

    of: Sequence[CameraCase]
    options: Options
    rows: dict[tuple[str, int, str], list[Row]] = field(default_factory=dict)

    def need(self, kinds: Iterable[tuple[str, int]]) -> None:
        """Track and score the cases with these kinds and seeds, unless that was done."""
        new = [each for each in kinds if (*each, OUTPUTS[0]) not in self.rows]
        if not new:
            return
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            runs = [LookRun(case, *each, place) for each in new for case in self.of]
            in_parallel(track, runs, "appearance", self.options)
            jobs = [(kind, seed, output) for kind, seed in new for output in OUTPUTS]
            names = [(f"{kind}-{seed}", output, folder) for kind, seed, output in jobs]
            found = in_parallel(scored, names, "scores", self.options)
        self.rows.update(zip(jobs, found, strict=True))

    def by_group(self, kind: str, seed: int, output: str) -> dict[str, F8]:
        """The scores of each group."""
        return by_group(self.rows[kind, seed, output])

    def gains(self, kind: str, seeds: Sequence[int], output: str) -> F8:
        """(seeds, groups, scores) the differences to the runs without embeddings."""
        usual = self.by_group(NONE, 1, output)
        return np.array(
            [
                [
                    self.by_group(kind, seed, output)[group] - values
                    for group, values in usual.items()
                ]
                for seed in seeds
            ]
        )


def by_group(rows: Sequence[Row]) -> dict[str, F8]:
    """(scores,) of each group, its cases pooled."""
    return {
        row["group"]: np.array([float(row[score]) for score in SCORES])
        for row in rows
        if row["sequence"] == "ALL"
    }


def mean_of(rows: Sequence[Row]) -> F8:
    """(scores,) the mean over groups."""
    mean: F8 = np.mean(list(by_group(rows).values()), axis=0)
    return mean


def by_case(rows: Sequence[Row]) -> dict[tuple[str, str], Row]:
    """The rows of single cases by sequence and detector."""
    return {(row["sequence"], row["detector"]): row for row in rows if row["sequence"] != "ALL"}


def signed(values: Sequence[float], digits: int = 2) -> str:
    """A cell: a difference with its sign, ± its standard error."""
    text = with_error(values, digits)
    return text if text.startswith("-") else f"+{text}"


def made_section(options: Options, runs: LookRuns) -> str:
    """Embeddings made from the truth, by quality."""
    seeds = range(1, options.number(SEEDS, 1) + 1)
    runs.need([(NONE, 1), *((quality, seed) for quality in QUALITIES for seed in seeds)])
    absolute = [[NONE]]
    relative = []
    for output in OUTPUTS:
        absolute[0] += [f"{value:.1f}" for value in mean_of(runs.rows[NONE, 1, output])]
    for quality in QUALITIES:
        values = [quality]
        gains = [quality]
        for output in OUTPUTS:
            means = [mean_of(runs.rows[quality, seed, output]) for seed in seeds]
            values += [f"{value:.1f}" for value in np.mean(means, axis=0)]
            by_seed = runs.gains(quality, seeds, output).mean(axis=1)
            gains += [signed(column.tolist()) for column in by_seed.T]
        absolute.append(values)
        relative.append(gains)
    header = ["embeddings", *(f"{score}, {output}" for output in OUTPUTS for score in SCORES)]
    return filled(
        "appearance_made",
        cases=len(runs.of),
        seeds=len(seeds),
        absolute=table(header, absolute),
        relative=table(header, relative),
        groups=_groups_table(runs, seeds),
        verdict=_made_verdict(runs, seeds),
    )


def _groups_table(runs: LookRuns, seeds: Sequence[int]) -> str:
    """The gain in IDF1 of each group."""
    place = SCORES.index("IDF1")
    columns = [
        runs.gains(quality, seeds, output)[:, :, place]
        for output in OUTPUTS
        for quality in QUALITIES
    ]
    rows = [
        [group, *(signed(column[:, k].tolist(), 1) for column in columns)]
        for k, group in enumerate(runs.by_group(NONE, 1, OUTPUTS[0]))
    ]
    header = ("group", *(f"{quality}, {output}" for output in OUTPUTS for quality in QUALITIES))
    return table(header, rows)


def _made_verdict(runs: LookRuns, seeds: Sequence[int]) -> str:
    """The gains in IDF1 online against the goals."""
    place = SCORES.index("IDF1")
    parts = []
    for quality, goal in GOALS.items():
        gain = float(runs.gains(quality, seeds, "online")[:, :, place].mean())
        parts.append(f"{gain:+.1f} with {quality} ones ({_reached(gain >= goal)} +{goal:g})")
    return f"IDF1 online: {', '.join(parts)}."


def _reached(goal: bool) -> str:
    return "reaches the goal of" if goal else "misses the goal of"


def peers_section(options: Options, runs: LookRuns) -> str:
    """The comparison with trackers that use the same embeddings."""
    if not CSV.is_file():
        keep_peers(scored_peers(options))
    kept = kept_peers()
    known = [quality for quality in QUALITIES if any(row["quality"] == quality for row in kept)]
    seed = PEERS_SEEDS[0]
    runs.need([(NONE, 1), *((quality, seed) for quality in known)])
    names = {case.name for case in runs.of}
    groups = {case.group for case in runs.of}
    peers = {
        (quality, name): [
            row
            for row in kept
            if (row["quality"], row["tracker"]) == (quality, name)
            and (f"{row['sequence']}_{row['detector']}" in names or row["sequence"] == "ALL")
            and row["group"] in groups
        ]
        for quality in known
        for name in PEERS
    }
    own = {quality: runs.rows[quality, seed, "online"] for quality in known}
    without = runs.rows[NONE, 1, "online"]
    return filled(
        "appearance_peers",
        means=_means_table(own, without, peers),
        groups=_pairs_table(own, without, peers),
        behind=_behind_table(own, peers),
        verdict=_peers_verdict(own, peers),
    )


# By quality the rows of ours, and by quality and name those of a peer.
OwnRows = Mapping[str, Sequence[Row]]
PeerRows = Mapping[tuple[str, str], Sequence[Row]]


def _means_table(own: OwnRows, without: Sequence[Row], peers: PeerRows) -> str:
    """The means over groups of all trackers."""

    def cell(rows: Sequence[Row]) -> str:
        return " / ".join(f"{value:.1f}" for value in mean_of(rows))

    rows = [["phdtrack without", *(cell(without) for _ in own)]]
    rows.append(["phdtrack", *(cell(own[quality]) for quality in own)])
    rows += [[name, *(cell(peers[quality, name]) for quality in own)] for name in PEERS]
    return table(("tracker", *own), rows)


def ahead(
    own: Sequence[Row], peers: Sequence[Sequence[Row]], group: str = ""
) -> list[tuple[float, float, Row, str]]:
    """For each (case, score) pair 1 where ours is ahead of the best peer, 0.5 if they are equal,
    else 0; the difference; and the pair. ``group``: only its pairs.
    """
    others = [by_case(rows) for rows in peers]
    found = []
    for case, row in by_case(own).items():
        if group not in ("", row["group"]):
            continue
        for score in SCORES:
            away = float(row[score]) - max(float(rows[case][score]) for rows in others)
            verdict = 0.5 if abs(away) < TIE else float(away > 0)
            found.append((verdict, away, row, score))
    return found


def _pairs_table(own: OwnRows, without: Sequence[Row], peers: PeerRows) -> str:
    """Pairs in which ours is ahead, by group and by score; without embeddings and with them."""
    rows = list[list[object]]()
    pairs = {}
    for quality in own:
        of = [peers[quality, name] for name in PEERS]
        pairs[quality] = (ahead(without, of), ahead(own[quality], of))

    def cells(wanted: Callable[[Row, str], bool]) -> list[object]:
        out = list[object]()
        for each in pairs.values():
            for verdicts in each:
                those = [one[0] for one in verdicts if wanted(one[2], one[3])]
                out.append(f"{sum(those):g} of {len(those)}")
        return out

    for group in by_group(without):
        rows.append([group, *cells(lambda row, _, group=group: row["group"] == group)])  # type: ignore[misc]
    for score in SCORES:
        rows.append([score, *cells(lambda _, one, score=score: one == score)])  # type: ignore[misc]
    rows.append(["all", *cells(lambda _, __: True)])
    header = ["pairs"]
    for quality in own:
        header += [f"{quality}: without", "with"]
    return table(header, rows)


def _behind_table(own: OwnRows, peers: PeerRows) -> str:
    """The pairs in which ours is furthest behind."""
    found = []
    for quality in own:
        of = [peers[quality, name] for name in PEERS]
        for _, away, row, score in ahead(own[quality], of):
            case = f"{row['sequence']} {row['detector']}"
            value = float(row[score])
            found.append((away, quality, row["group"], case, score, value))
    rows = [
        [quality, group, case, score, f"{value:.1f}", f"{value - away:.1f}"]
        for away, quality, group, case, score, value in sorted(found)[:LISTED]
        if away < 0
    ]
    return table(("embeddings", "group", "case", "score", "phdtrack", "best peer"), rows)


def _peers_verdict(own: OwnRows, peers: PeerRows) -> str:
    parts = []
    for quality in own:
        verdicts = [one[0] for one in ahead(own[quality], [peers[quality, n] for n in PEERS])]
        share = float(np.mean(verdicts))
        parts.append(f"{100 * share:.0f} % with {quality} embeddings ({_reached(share >= AHEAD)}")
        parts[-1] += f" {100 * AHEAD:g} %)"
    return f"Ahead of the best of the four online: {', '.join(parts)}."


def scored_peers(options: Options) -> list[Row]:
    """Run the peers, unless their tracks are there, and score them: rows of `CSV`."""
    arguments = [need_data(), PEERS_TRACKS]
    run_peers("appearance", arguments, options.jobs, BOXMOT_PYTHON)
    jobs = [
        (quality, seed, name) for quality in QUALITIES for seed in PEERS_SEEDS for name in PEERS
    ]
    return [row for rows in in_parallel(_scored_peer, jobs, "peers", options) for row in rows]


def _scored_peer(job: tuple[str, int, str]) -> list[Row]:
    """The scores of one peer's tracks with embeddings of a quality and a seed."""
    quality, seed, name = job
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / name
        for case in all_cases():
            path = PEERS_TRACKS / f"{quality}-{seed}" / name / case.detector
            path = path / f"{case.sequence}.txt"
            if case.group == OLD_GROUP:
                keep(read_tracks(path), place, "online", case.sequence, case.detector)
                continue
            to = place / "online" / case.detector
            to.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, to)
        rows = scored((name, "online", folder))
    kept = ("group", "sequence", "detector", *SCORES)
    first = {"quality": quality, "seed": str(seed), "tracker": name}
    return [{**first, **{key: row[key] for key in kept}} for row in rows]


def keep_peers(rows: Sequence[Row]) -> None:
    """Write the peers' scores to `CSV`."""
    with CSV.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({**row, **{score: f"{float(row[score]):.3f}" for score in SCORES}})


def kept_peers() -> list[Row]:
    """The peers' scores in `CSV`."""
    with CSV.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def harmless_section(options: Options, runs: LookRuns) -> str:
    """Embeddings that say nothing, or the wrong thing."""
    runs.need([(NONE, 1), *((kind, 1) for kind in HARMFUL)])
    rows = []
    over = []
    for kind, text in HARMFUL.items():
        gains = [runs.gains(kind, (1,), output).mean(axis=(0, 1)) for output in OUTPUTS]
        cells = [
            f"{gain[SCORES.index(score)]:+.2f}" for gain in gains for score in ("IDF1", "HOTA")
        ]
        rows.append([kind, text, *cells])
        worst = min(min(gain[SCORES.index("IDF1")], gain[SCORES.index("HOTA")]) for gain in gains)
        if worst < -HARM:
            over.append(f"{kind} ({worst:+.2f})")
    header = ["embeddings", "what they are"]
    header += [f"{score}, {output}" for output in OUTPUTS for score in ("IDF1", "HOTA")]
    groups = [
        [
            group,
            *(
                f"{runs.gains(kind, (1,), output)[0, k, SCORES.index('IDF1')]:+.1f}"
                for kind in HARMFUL
                for output in OUTPUTS
            ),
        ]
        for k, group in enumerate(runs.by_group(NONE, 1, OUTPUTS[0]))
    ]
    return filled(
        "appearance_harmless",
        goal=f"{HARM:g}",
        table=table(header, rows),
        groups=table(
            ("group", *(f"{kind}, {output}" for kind in HARMFUL for output in OUTPUTS)), groups
        ),
        verdict=(
            f"More is lost with: {', '.join(over)}."
            if over
            else "None of them costs more than that."
        ),
    )


Part = Callable[[Options, LookRuns], str]
PARTS: Mapping[str, Part] = {
    "made": made_section,
    "peers": peers_section,
    "harmless": harmless_section,
    "pictures": lambda options, _: appearance_pictures.section(options),
    "videos": lambda options, _: appearance_pictures.videos_section(options),
    "returns": lambda options, _: appearance_returns.section(options),
    "cost": lambda options, _: appearance_cost.section(options),
}
# Made only if they are asked for.
LONG = ("videos",)


def main(options: Options) -> Path:
    """Make the parts that were asked for, or all but the `LONG` ones, and write appearance.md."""
    of = [case for case in all_cases() if not options.quick or case.sequence in SHORT]
    runs = LookRuns(of, options)
    path = options.folder / "appearance.md"
    for name in options.parts(PARTS, LONG):
        # Each is written when it is made: all together take an hour.
        path = write_parts("appearance", options, PARTS, {name: PARTS[name](options, runs)})
    return path
