"""How well the Markov chain of an MCMC filter moved over a whole run, in numbers and in a sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phdtrack.types import ChainInfo

LOW = 20.0
"""Effective samples below which positions are doubtful: their error by chance is 1/√20 = 22 % of their posterior spread."""


@dataclass(frozen=True, slots=True)
class ChainSummary:
    """Over the frames of a run.

    Attributes
    ----------
    acceptance : by the name of a move, how many of those proposed were accepted (0–1), mean over frames with any.
    effective : mean of `ChainInfo.effective` over the frames in which somebody was there; NaN where nobody ever was.
    low : share of these frames (0–1) in which it was below `LOW`.
    """

    acceptance: Mapping[str, float]
    effective: float
    low: float

    @property
    def sentence(self) -> str:
        """In words."""
        moves = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.acceptance.items())
        told = f"The chain accepted, of the moves that it proposed: {moves or 'there were none'}."
        if not math.isfinite(self.effective):
            return told
        return f"{told} Its samples of a frame were worth {self.effective:.0f} independent ones on average."

    @property
    def warning(self) -> str:
        """What a user should do where the chain moved too little; empty where it moved well enough."""
        if not self.low > 0.5:
            return ""
        return (
            f"the chain moved little: in {100 * self.low:.0f} % of the frames its samples are worth fewer than {LOW:.0f} "
            "independent ones; more filter.samples, or a greater filter.thin, make positions surer"
        )


def chain_summary(frames: Sequence[ChainInfo]) -> ChainSummary | None:
    """Of all frames' chains; None where there were none."""
    if not frames:
        return None
    shares: dict[str, list[float]] = {}
    for frame in frames:
        for name, proposed, accepted in zip(frame.moves, frame.proposed.tolist(), frame.accepted.tolist(), strict=True):
            if proposed:
                shares.setdefault(name, []).append(accepted / proposed)
    effective = np.array([frame.effective for frame in frames])
    known = effective[np.isfinite(effective)]
    return ChainSummary(
        {name: float(np.mean(each)) for name, each in shares.items()},
        float(known.mean()) if len(known) else math.nan,
        float((known < LOW).mean()) if len(known) else 0.0,
    )
