"""The claims of a paper beside what was measured: a verdict for each, made of the figures.

A claim is judged case by case; the verdict says on how many cases it holds, and on which. The same
claims stand in a table on the page and are printed on the terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phdtrack.compare.statistics import interval

# The forms in which a paper's method is run.
WORDS = "word by word"
MENDED = "as one must"
OURS = "what we would use"
# With fewer seeds an error says nothing: half the 95 % interval of two is 12.7 standard errors.
FEWEST = 3
# Names of cases that a verdict lists, at most.
LISTED = 4


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of a paper, and what was measured.

    Attributes
    ----------
    claim : in the paper's words.
    printed : its figures.
    form : how the method was run: `WORDS`, `MENDED`, `OURS`, or another name.
    ours : our figures.
    where : by case, whether the claim holds there; None: the difference is within its error.
    """

    claim: str
    printed: str
    form: str
    ours: str
    where: Mapping[str, bool | None]

    @property
    def verdict(self) -> str:
        """Holds, does not hold, or on which cases it holds."""
        good, bad, open_ = (
            [name for name, holds in self.where.items() if holds is wanted]
            for wanted in (True, False, None)
        )
        if not self.where:
            return "not measured"
        if open_:
            return self._with_open(good, bad, open_)
        if not bad:
            return "holds" if len(good) == 1 else f"holds on all {len(good)}"
        if not good:
            return "does not hold" if len(bad) == 1 else f"holds on none of {len(bad)}"
        count = f"holds on {len(good)} of {len(self.where)}"
        if len(good) <= min(len(bad), LISTED):
            return f"{count}: {', '.join(good)}"
        if len(bad) <= LISTED:
            return f"{count}, not on {', '.join(bad)}"
        return count

    @staticmethod
    def _with_open(good: Sequence[str], bad: Sequence[str], open_: Sequence[str]) -> str:
        """The verdict if the difference is within its error on some cases."""
        total = len(good) + len(bad) + len(open_)
        if len(open_) == total:
            return "within its error" if total == 1 else f"within its error on all {total}"
        words = [f"holds on {len(good)} of {total}{_listed(good)}"]
        if bad:
            words.append(f"does not on {len(bad)}{_listed(bad)}")
        return ", ".join([*words, f"within its error on {len(open_)}{_listed(open_)}"])


def _listed(names: Sequence[str]) -> str:
    """The names in brackets, or nothing if there are none or too many."""
    return f" ({', '.join(names)})" if 0 < len(names) <= LISTED else ""


def decided(gaps: Sequence[float]) -> bool | None:
    """True if differences between two runs are positive, False if not, None if their mean is within
    its error.

    Parameters
    ----------
    gaps : independent differences, one a seed. The error is half the 95 % interval of their mean
        (Student's t). Fewer than `FEWEST` have none: the sign of their mean decides. Differences
        that are not numbers are not positive.
    """
    if len(gaps) < FEWEST:
        return bool(len(gaps) > 0 and np.mean(gaps) > 0)
    mean = interval(gaps)
    if np.isfinite(mean.half) and not mean.clear:
        return None
    return bool(mean.mean > 0)


def claims_table(claims: Iterable[Claim]) -> str:
    """A Markdown table of claims, a line each; a claim that is repeated in another form is not
    written again.
    """
    lines = ["| the paper | printed | form | ours | |", "| --- | --- | --- | --- | --- |"]
    before = ""
    for one in claims:
        said = ("", "") if one.claim == before else (one.claim, one.printed)
        lines.append(f"| {' | '.join((*said, one.form, one.ours))} | **{one.verdict}** |")
        before = one.claim
    return "\n".join(lines) + "\n"


def claims_text(claims: Sequence[Claim]) -> str:
    """The claims for a terminal: each with its printed figures, below it a line for each form."""
    lines = []
    before = ""
    width = max((len(one.form) for one in claims), default=0)
    for one in claims:
        if one.claim != before:
            lines.append(f"{one.claim} (printed: {one.printed})")
        lines.append(f"    {one.form:<{width}}  {one.ours}: {one.verdict}")
        before = one.claim
    return "\n".join(lines)
