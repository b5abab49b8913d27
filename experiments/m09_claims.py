"""M09's claims beside ours, with the paper's recursion alone and with births of a second pass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.claims import MENDED, WORDS, Claim
from experiments.m09_runs import AFTER, PRINTED, TUNED, UM, SceneRun
from experiments.scenes import SceneResults, short_of

# The learned model in each form.
FORMS = {WORDS: PRINTED, MENDED: AFTER}


def claims(found: SceneResults) -> list[Claim]:
    """The claims of Figs. 14 to 16 and of the cost."""
    out = []
    for than, name in ((UM, "the uniform model"), (TUNED, "the uniform model, tuned")):
        for form, run in FORMS.items():
            out.append(
                _above(found, f"GM is above {name} in accuracy (MODA)", "+9 %, +14 %", form,
                       (run, than), "MODA")
            )  # fmt: skip
    out.append(_above(found, "learned clutter helps more than learned births: A2 above A1",
                      "Fig. 14", MENDED, ("A2", "A1")))  # fmt: skip
    out.append(_above(found, "A5 above A4", "Fig. 14", MENDED, ("A5", "A4")))
    for form, run in FORMS.items():
        out.append(_above(found, "births and clutter together are best: GM above A2", "Fig. 14",
                          form, (run, "A2")))  # fmt: skip
    out.append(_above(found, "births by hand are better where false alarms are the main error: A6"
                      " above GM", "S201 yes, S101 no", MENDED, ("A6", AFTER)))  # fmt: skip
    for form, run in FORMS.items():
        out.append(_earlier(found, form, run))
    for form, run in FORMS.items():
        out.append(_every_rate(found, form, run))
    return [*out, *_order(found), _cost(found)]


def _above(
    found: SceneResults,
    claim: str,
    printed: str,
    form: str,
    runs: tuple[str, str],
    score: str = "MOTA",
) -> Claim:
    """One run is above another, by the means over seeds."""
    one, other = runs
    gaps = {
        name: found.mean(name, one, score) - found.mean(name, other, score) for name in found.scenes
    }
    values = list(gaps.values())
    ours = f"{score} {np.mean(values):+.3f} in the mean, {min(values):+.3f} to {max(values):+.3f}"
    return Claim(claim, printed, form, ours, _positive(gaps))


def _positive(gaps: Mapping[str, float]) -> dict[str, bool]:
    return {name: bool(gap > 0) for name, gap in gaps.items()}


def _earlier(found: SceneResults, form: str, run: str) -> Claim:
    pairs = {
        name: (found.delay(name, run, "inside"), found.delay(name, UM, "inside"))
        for name in found.scenes
    }
    known = {name: pair for name, pair in pairs.items() if np.isfinite(pair).all()}
    mean = np.mean(list(known.values()), axis=0) if known else (np.nan, np.nan)
    return Claim(
        "objects that enter where people enter are output earlier with GM",
        "earlier",
        form,
        f"{mean[0]:.1f} frames after the first detection, UM {mean[1]:.1f}",
        {name: bool(learned < plain) for name, (learned, plain) in known.items()},
    )


def _every_rate(found: SceneResults, form: str, run: str) -> Claim:
    gaps = {}
    for name in found.scenes:
        best = max(one.MOTA for one in found.sweep(name, UM).values())
        gaps[name] = found.short_run(name, run).scores.MOTA - best
    return Claim(
        "GM is above UM for every pair of magnitudes (MOTA)",
        "Fig. 15",
        form,
        f"{min(gaps.values()):+.3f} to {max(gaps.values()):+.3f} against the best pair",
        _positive(gaps),
    )


def _order(found: SceneResults) -> list[Claim]:
    """PROP, then MHT, then DA: with scaled variances, and with fixed ones for both."""
    out = []
    rows = (
        (WORDS, "fixed variances, nothing learned", ("fv", UM), ("m09-mht", UM)),
        (WORDS, "fixed variances, PROP learned", ("fv", AFTER), ("m09-mht", UM)),
        (MENDED, "the same models, nothing learned", ("", UM), ("mht", UM)),
    )
    for form, words, own, rival in rows:
        values = {
            name: [_score(found, name, *key) for key in (own, rival, ("none", UM))]
            for name in found.scenes
        }
        known = {name: each for name, each in values.items() if np.isfinite(each).all()}
        if not known:
            continue
        mean = np.mean(list(known.values()), axis=0)
        out.append(
            Claim(
                f"PROP above MHT above DA in accuracy (MODA): {words}",
                "Fig. 16",
                form,
                ", ".join(f"{one:.2f}" for one in mean),
                {name: bool(each[0] > each[1] > each[2]) for name, each in known.items()},
            )
        )
    return out


def _score(found: SceneResults, scene: str, filter_: str, run: str) -> float:
    """MODA of a tracker on the frames of the comparison; NaN if it was not run."""
    key = SceneRun(scene, 1, run, filter_, frames=short_of(found.scenes[scene]))
    one = found.runs_.get(key)
    return float("nan") if one is None else float(one.scores.MODA)


def _cost(found: SceneResults) -> Claim:
    ratio = {name: learned / plain for name, (plain, learned, _) in found.timings.items()}
    return Claim(
        "no extra cost per frame",
        "stated",
        MENDED,
        f"{', '.join(f'{one:.2f}' for one in ratio.values())} times UM's filter time",
        {name: bool(one < 1.1) for name, one in ratio.items()},
    )
