"""M09's claims beside ours, with the paper's recursion alone and with births of a second pass.

Each claim is about differences between two runs, one for each seed: it holds on a scene if their
mean is positive and beyond its error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.claims import MENDED, WORDS, Claim, decided
from experiments.common import with_error
from experiments.m09_runs import (
    ABLATIONS,
    AFTER,
    PRINTED,
    TUNED,
    TUNED_PRINTED,
    UM,
    UM_PRINTED,
)
from experiments.scenes import SceneResults

# In each form: the learned model, the uniform one, and the uniform one with tuned magnitudes.
FORMS = {WORDS: (PRINTED, UM_PRINTED, TUNED_PRINTED), MENDED: (AFTER, UM, TUNED)}
# By scene, differences for each seed; positive: as claimed.
Gaps = Mapping[str, Sequence[float]]


def claims(found: SceneResults) -> list[Claim]:
    """The claims of Figs. 14 to 16 and of the cost."""
    return [*_parts(found), *_earlier(found), *_every_rate(found), *_order(found), _cost(found)]


def judged(claim: str, printed: str, form: str, unit: str, gaps: Gaps, digits: int = 3) -> Claim:
    """A claim about differences, with their mean over the scenes and its standard error."""
    known = {name: each for name, each in gaps.items() if each}
    means = [float(np.mean(each)) for each in known.values()]
    if not known:
        return Claim(claim, printed, form, "–", {})
    same = len({len(each) for each in known.values()}) == 1
    over_scenes = np.mean(list(known.values()), axis=0).tolist() if same else [np.mean(means)]
    ours = f"{unit} {with_error(over_scenes, digits, '+')}"
    if len(known) > 1:
        ours += f"; by scene {min(means):+.{digits}f} to {max(means):+.{digits}f}"
    return Claim(claim, printed, form, ours, {name: decided(each) for name, each in known.items()})


def best_rates(found: SceneResults, scene: str, plain: str) -> tuple[float, float]:
    """The rates of a uniform model with the highest mean MOTA on the frames of the test."""
    swept = found.sweep(scene, plain)
    return max(
        swept, key=lambda rates: float(np.mean(found.each(scene, plain, "MOTA", rates=rates)))
    )


def _parts(found: SceneResults) -> list[Claim]:
    """Fig. 14: one run above another on all frames."""
    learned = [
        (f"GM is above {name} in accuracy (MODA)", "+9 %, +14 %", form, those[0], those[k], "MODA")
        for k, name in ((1, "the uniform model"), (2, "the uniform model, tuned"))
        for form, those in FORMS.items()
    ]
    clutter = "learned clutter helps more than learned births: A2 above A1"
    both = "births and clutter together are best: GM above A2"
    by_hand = "births by hand are better where false alarms are the main error: A6 above GM"
    rows = [
        *learned,
        (clutter, "Fig. 14", MENDED, "A2", "A1", "MOTA"),
        ("A5 above A4", "Fig. 14", MENDED, "A5", "A4", "MOTA"),
        (both, "Fig. 14", MENDED, AFTER, "A2", "MOTA"),
        (by_hand, "S201 yes, S101 no", MENDED, "A6", AFTER, "MOTA"),
    ]
    return [
        judged(
            claim,
            printed,
            form,
            score,
            {name: found.gaps(name, one, other, score) for name in found.scenes},
        )
        for claim, printed, form, one, other, score in rows
    ] + [_ahead_of_the_rest(found, run, name) for run, name in ((AFTER, "GM"), ("A6", "A6"))]


def _ahead_of_the_rest(found: SceneResults, run: str, name: str) -> Claim:
    """Fig. 14: MOTA of a run less that of the best of A1 to A5, chosen on the tested frames."""
    gaps = {}
    for scene in found.scenes:
        rest = [one for one in ABLATIONS if one != "A6"]
        best = max(rest, key=lambda one: found.mean(scene, one, "MOTA"))
        gaps[scene] = found.gaps(scene, run, best, "MOTA")
    claim = f"{name} is ahead of A1 to A5"
    return judged(claim, "Fig. 14", MENDED, "MOTA less the best's", gaps)


def _earlier(found: SceneResults) -> list[Claim]:
    """Delays of the uniform model less those of the learned one, where people enter."""
    claim = "objects that enter where people enter are output earlier with GM"
    return [
        judged(claim, "earlier", form, "frames", _delay_gaps(found, learned, plain), 1)
        for form, (learned, plain, _) in FORMS.items()
    ]


def _delay_gaps(found: SceneResults, learned_run: str, plain_run: str) -> Gaps:
    """By scene, differences of the mean delays of the seeds that have any."""
    gaps = {}
    for name in found.scenes:
        pairs = zip(found.runs(name, plain_run), found.runs(name, learned_run), strict=True)
        gaps[name] = [
            float(np.mean([*plain.inside.values()]) - np.mean([*learned.inside.values()]))
            for plain, learned in pairs
            if plain.inside and learned.inside
        ]
    return gaps


def _every_rate(found: SceneResults) -> list[Claim]:
    """Fig. 15: against the best pair of magnitudes, chosen on the frames of the test."""
    out = []
    for form, (run, uniform, _) in FORMS.items():
        gaps = {}
        for name in found.scenes:
            rates = best_rates(found, name, uniform)
            best = found.each(name, uniform, "MOTA", rates=rates)
            pairs = zip(found.each_short(name, run, "MOTA"), best, strict=True)
            gaps[name] = [learned - plain for learned, plain in pairs]
        claim = "GM is above UM for every pair of magnitudes (MOTA)"
        out.append(judged(claim, "Fig. 15", form, "MOTA less the best pair's", gaps))
    return out


def _order(found: SceneResults) -> list[Claim]:
    """Fig. 16, MODA: PROP above MHT, with scaled variances and with fixed ones for both, and MHT
    above DA.
    """
    above_mht = "PROP above MHT in accuracy (MODA)"
    above_da = "MHT above DA in accuracy (MODA)"
    rows = (
        (above_mht, WORDS, "fixed variances:", ("fv", UM_PRINTED), ("m09-mht", UM)),
        (above_mht, WORDS, "fixed variances, PROP learned:", ("fv", PRINTED), ("m09-mht", UM)),
        (above_mht, MENDED, "fixed variances, PROP learned:", ("fv", AFTER), ("m09-mht", UM)),
        (above_mht, MENDED, "the same models, nothing learned:", ("", UM), ("mht", UM)),
        (above_da, WORDS, "fixed variances:", ("m09-mht", UM), ("none", UM)),
        (above_da, MENDED, "the same models, nothing learned:", ("mht", UM), ("none", UM)),
    )
    out = []
    for claim, form, words, own, rival in rows:
        gaps = {}
        for name in found.scenes:
            pairs = zip(_moda(found, name, *own), _moda(found, name, *rival), strict=True)
            gaps[name] = [a - b for a, b in pairs]
        out.append(judged(claim, "Fig. 16", form, words, gaps))
    return out


def _moda(found: SceneResults, scene: str, filter_: str, run: str) -> list[float]:
    """MODA of a tracker for each seed, on the frames of the comparison."""
    if filter_:
        return found.each(scene, run, "MODA", filter_)
    return found.each_short(scene, run, "MODA")


def _cost(found: SceneResults) -> Claim:
    """What the learned model costs less than the uniform one, block by block."""
    saved = {
        name: (1 - learned / plain).tolist() for name, (plain, learned, _) in found.timings.items()
    }
    ours = ", ".join(f"{with_error([1 - one for one in each], 2)}" for each in saved.values())
    return Claim(
        "no extra cost per frame",
        "stated",
        MENDED,
        f"{ours} times UM's filter time",
        # Not above UM's beyond its error.
        {name: decided(each) is not False for name, each in saved.items()},
    )
