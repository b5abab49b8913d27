"""What M09's experiment says, in words made of its numbers: nothing here is written that was not counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from experiments import m09_places
from experiments.m09_runs import GM, IMAGE, UM
from phdtrack.metrics import pool

if TYPE_CHECKING:
    from experiments.m09 import Found

# What was asked for: MOTA up by so much, or by such a share where the uniform model's is above a half; frame rates the same
# to this part; false tracks at the places gone.
POINTS, SHARE, HALF = 0.10, 0.10, 0.5
SAME_RATE = 0.05
GONE = 0.95


def verdict(found: Found) -> str:
    """GM against UM, the sweep, the rivals, and the frame rate, a line each."""
    lines = [
        _above(found),
        _little(found),
        _much(found),
        _fewer(found),
        _earlier(found),
        _best_uniform(found),
        *(_above_rival(found, name) for name in ("none", "mht")),
        _rate(found),
    ]
    return "\n".join(f"- {line}" for line in lines if line)


def _above(found: Found) -> str:
    gains = {name: [found.gain([name], GM, score).mean for score in ("MODA", "MOTA")] for name in found.scenes}
    fine = [name for name, both in gains.items() if min(both) > 0]
    rest = [f"{name} ({both[0]:+.3f}, {both[1]:+.3f})" for name, both in gains.items() if name not in fine]
    return f"**GM above UM in MODA and MOTA**: {_of(fine, found.scenes)}{_except(rest)}"


def _little(found: Found) -> str:
    """Where GM is not above UM: how much there was to gain, and to learn from."""
    told = []
    for name in found.scenes:
        if min(found.gain([name], GM, score).mean for score in ("MODA", "MOTA")) > 0:
            continue
        scene = found.taught[found.course(name)]
        births = f"{scene.births.samples} tracks" if scene.births else "no births, of which there were too few"
        false = found.mean(name, UM, "false_tracks")
        told.append(f"{name}: UM makes {false:.1f} false tracks; learned from {scene.clutter.samples} marks and {births}")
    return f"**Where it is not, there is little to gain and little to learn from**: {'; '.join(told)}" if told else ""


def _much(found: Found) -> str:
    groups = [found.groups()[name] for name in found.groups() if name.startswith("all rendered")] or [tuple(found.scenes)]
    gain = found.gain(groups[0], GM, "MOTA")
    before = pool([one.scores for name in groups[0] for one in found.runs(name, UM)]).MOTA
    needed = SHARE * float(before) if before > HALF else POINTS
    told = "reached" if gain.mean >= needed else "**not reached**"
    each = ", ".join(
        f"{name} {found.mean(name, UM, 'MOTA'):.3f} → {found.mean(name, GM, 'MOTA'):.3f}" for name in found.scenes
    )
    return (
        f"**On the rendered scenes, all with persistent clutter, MOTA up by {gain.mean:.3f} pooled** (asked: {needed:.2f}; "
        f"{told}). By scene: {each}"
    )


def _fewer(found: Found) -> str:
    counts = {name: [found.mean(name, run, "false_tracks") for run in (UM, GM)] for name in found.scenes}
    fine = [name for name, (uniform, learned) in counts.items() if learned < uniform]
    rest = [f"{name} ({uniform:.0f} → {learned:.0f})" for name, (uniform, learned) in counts.items() if name not in fine]
    sums = [sum(each[k] for each in counts.values()) for k in range(2)]
    return f"**Fewer false tracks**: {_of(fine, found.scenes)}; {sums[0]:.0f} → {sums[1]:.0f} in all{_except(rest)}"


def _earlier(found: Found) -> str:
    late = {name: found.delayed(name) for name in found.scenes}
    late = {name: both for name, both in late.items() if np.isfinite(both[0])}
    fine = [name for name, (uniform, learned, _, _) in late.items() if learned < uniform]
    each = ", ".join(f"{name} {a:.1f} → {b:.1f} (found: {m} → {n})" for name, (a, b, m, n) in late.items())
    told = "frames after the first detection, of those whom both find"
    return f"**First output earlier where people enter**: {_of(fine, late)}; {told}: {each}"


def _best_uniform(found: Found) -> str:
    behind = {}
    for name in found.scenes:
        best = max(one.MOTA for run in (UM, IMAGE) for one in found.sweep(name, run).values())
        behind[name] = found.beside(name, GM).scores.MOTA - best
    fine = [name for name, gap in behind.items() if gap > 0]
    rest = [f"{name} ({gap:+.3f})" for name, gap in behind.items() if gap <= 0]
    return f"**The best uniform setting of the sweep still below GM in MOTA**: {_of(fine, found.scenes)}{_except(rest)}"


def _above_rival(found: Found, name: str) -> str:
    gaps = {}
    for scene in found.scenes:
        ours, theirs = found.beside(scene, GM).scores, found.beside(scene, UM, name).scores
        gaps[scene] = (ours.MODA - theirs.MODA, ours.MOTA - theirs.MOTA)
    fine = [scene for scene, gap in gaps.items() if min(gap) > 0]
    rest = [f"{scene} ({gap[0]:+.3f}, {gap[1]:+.3f})" for scene, gap in gaps.items() if scene not in fine]
    return f"**GM above `{name}`** (uniform) in MODA and MOTA: {_of(fine, found.scenes)}{_except(rest)}"


def _rate(found: Found) -> str:
    times = {f"{one.course.footage.name}, {one.filter}": seconds for one, seconds in found.races.items()}
    alone = {name: learned / uniform for name, (uniform, learned, _) in times.items()}
    whole = {name: (looking + learned) / (looking + uniform) for name, (uniform, learned, looking) in times.items()}
    same, together = ([name for name, ratio in each.items() if ratio <= 1 + SAME_RATE] for each in (alone, whole))
    each = ", ".join(f"{name} {ratio:.2f}" for name, ratio in alone.items())
    most = f"with the detector that sees these scenes ({max(whole.values()):.3f} at most)"
    return (
        f"**A frame costs the same to {SAME_RATE:.0%}, or less**: {_of(same, alone)} by the filter alone, "
        f"{_of(together, whole)} {most}; time of GM over that of UM, alone: {each}"
    )


def findings(found: Found) -> str:
    """The paper's further findings, confirmed or not."""
    return "\n".join(
        f"- {line}"
        for line in (
            _compared(found, "A2", "A1", "Learned false alarms help more than learned births (A2 above A1)"),
            _compared(found, "A5", "A4", "The same with the other part's magnitude estimated (A5 above A4)"),
            _compared(found, GM, "A2", "Both together are better than learned false alarms alone (GM above A2)"),
            _hand(found, "garden", "Births by hand (A6) beat GM where false alarms are the main error", above=True),
            _hand(found, "arcade", "and lose to it where tracks begin again behind obstacles", above=False),
        )
        if line
    )


def _compared(found: Found, one: str, other: str, words: str) -> str:
    gaps = {name: found.mean(name, one, "MOTA") - found.mean(name, other, "MOTA") for name in found.scenes}
    fine = [name for name, gap in gaps.items() if gap > 0]
    each = ", ".join(f"{name} {gap:+.3f}" for name, gap in gaps.items())
    return f"{words}: {_of(fine, found.scenes)}. MOTA: {each}"


def _hand(found: Found, scene: str, words: str, above: bool) -> str:
    if scene not in found.scenes:
        return ""
    gaps = [found.mean(scene, "A6", score) - found.mean(scene, GM, score) for score in ("MODA", "MOTA")]
    confirmed = all((gap > 0) == above for gap in gaps)
    told = "**confirmed**" if confirmed else "**not confirmed**"
    return f"{words}: {told} on {scene}. A6 less GM: MODA {gaps[0]:+.3f}, MOTA {gaps[1]:+.3f}"


def crossing(places: Mapping[m09_places.Job, m09_places.Outcome]) -> str:
    """How many false tracks are gone, and who was lost, by filter."""
    lines = []
    for name in dict.fromkeys(job.filter for job in places):
        some = [one for job, one in places.items() if job.filter == name]
        before, after = (sum(one.false[k] for one in some) for k in range(2))
        people, lost, never = (sum(getattr(one, key) for one in some) for key in ("crossing", "lost", "never"))
        boxes = [sum(one.frames[k] for one in some) for k in range(2)]
        share = m09_places.gone(before, after)
        told = "reached" if share >= GONE else "**not reached**"
        lines.append(
            f"- `{name}`: {share:.1%} of {before} false tracks there are gone (asked: {GONE:.0%}; {told}), and "
            f"{m09_places.gone(*boxes):.1%} of the boxes that they had; of "
            f"{people} people who cross a place {lost} are lost, {never} never found again{_where(places, name)}."
        )
    return "\n".join(lines)


def _where(places: Mapping[m09_places.Job, m09_places.Outcome], filter_: str) -> str:
    """In which cases people are lost."""
    lost: dict[str, int] = {}
    for job, one in places.items():
        if job.filter == filter_ and one.lost:
            case = f"{job.name} with {job.rate:g} Poisson false alarms a frame"
            lost[case] = lost.get(case, 0) + one.lost
    return f" ({', '.join(f'{count} on {case}' for case, count in lost.items())})" if lost else ""


def _of(some: Sequence[str], all_: Mapping[str, object]) -> str:
    return f"on {len(some)} of {len(all_)}"


def _except(names: Sequence[str]) -> str:
    return f"; not on {', '.join(names)}" if names else ""
