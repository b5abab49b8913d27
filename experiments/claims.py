"""The claims of a paper beside what was measured: a verdict for each, made of the figures.

A claim is judged case by case; the verdict says on how many cases it holds, and on which. The same
claims stand in a table on the page and are printed on the terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

# The forms in which a paper's method is run.
WORDS = "word by word"
MENDED = "as one must"
OURS = "what we would use"
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
    where : by case, whether the claim holds there.
    """

    claim: str
    printed: str
    form: str
    ours: str
    where: Mapping[str, bool]

    @property
    def verdict(self) -> str:
        """Holds, does not hold, or on which cases it holds."""
        good = [name for name, holds in self.where.items() if holds]
        bad = [name for name, holds in self.where.items() if not holds]
        if not self.where:
            return "not measured"
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
