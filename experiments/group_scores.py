"""Scores of groups: pairwise F1 of membership, and switches of groups' identities.

Two people in the same frame are a pair, positive if both are in one group.

    F1 = 2 TP / (2 TP + FP + FN)    over the pairs of all frames

People of output and truth are mapped one to one, within a distance. A pair of annotated people is
missed (FN) if one of them was not found; a pair of one output group is false (FP) if a member is
unmapped. An annotated group switches if the output identity of most of its members differs from the
last one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.matching import assign, ratio
from phdtrack.types import F8, I8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFrame:
    """One frame: groups (n,) and positions (2, n) of the truth, and of the output (m,), (2, m),
    metres.

    Groups are identities from 1; 0 is a person without group.
    """

    truth_group: I8
    truth_position: F8
    output_group: I8
    output_position: F8


@dataclass(frozen=True, slots=True)
class GroupScores:
    """Pairs that are rightly together, wrongly together and wrongly apart; and identity switches of
    annotated groups.

    Precision, recall and F1 are NaN without pairs to count.
    """

    true_positives: int = 0
    false_positives: int = 0
    false_negatives: int = 0
    switches: int = 0

    def precision(self) -> float:
        """Share of the output's pairs that are right."""
        return ratio(self.true_positives, self.true_positives + self.false_positives)

    def recall(self) -> float:
        """Share of the annotated pairs that are found."""
        return ratio(self.true_positives, self.true_positives + self.false_negatives)

    def f1(self) -> float:
        """F1 of the pairs."""
        return ratio(
            2 * self.true_positives,
            2 * self.true_positives + self.false_positives + self.false_negatives,
        )


def score_groups(frames: Iterable[LabelledFrame], within: float = 1.0) -> GroupScores:
    """The scores of a sequence; people are mapped if they are closer than ``within`` metres."""
    sums = np.zeros(3, np.int64)
    switches = 0
    last = dict[int, int]()
    for frame in frames:
        output_of = np.full(len(frame.truth_group), -1)
        rows, columns = nearest(frame.truth_position, frame.output_position, within)
        output_of[rows] = columns
        sums += _pairs(frame, output_of)
        for group in np.unique(frame.truth_group[frame.truth_group > 0]).tolist():
            found = output_of[(frame.truth_group == group) & (output_of >= 0)]
            carried = frame.output_group[found]
            names, times = np.unique(carried[carried > 0], return_counts=True)
            best = names[times == times.max(initial=0)]
            if len(best) and last.get(group) not in best:
                switches += group in last
                last[group] = int(best[0])
    return GroupScores(int(sums[0]), int(sums[1]), int(sums[2]), switches)


def nearest(a: F8, b: F8, within: float) -> tuple[I8, I8]:
    """Columns of ``a`` (2, n) and ``b`` (2, m) mapped one to one, closer than ``within``: first as
    many pairs as possible, then the least distance.

    Parameters
    ----------
    a, b : (2, n), (2, m) points, metres.
    within : largest distance of a pair, metres.

    Returns
    -------
    Indices (k,) into ``a`` and into ``b``.
    """
    apart = np.hypot(a[0][:, None] - b[0], a[1][:, None] - b[1])
    # Every mapped pair outweighs any gain in distance.
    most = min(apart.shape) + 1 if apart.size else 1
    return assign(np.where(apart < within, most - apart / within, 0.0))


def _together(group: I8) -> Bool:
    """(n, n) whether two people are in one group, each pair once."""
    return np.triu((group[:, None] == group) & (group > 0), k=1)


def _pairs(frame: LabelledFrame, output_of: I8) -> I8:
    """Numbers of pairs that are rightly together, wrongly together, and wrongly apart."""
    truth = _together(frame.truth_group)
    output = _together(frame.output_group)
    carried = np.append(frame.output_group, 0)[output_of]  # 0 for those who were not found
    right = int((truth & _together(carried)).sum())
    return np.array([right, int(output.sum()) - right, int(truth.sum()) - right], np.int64)
