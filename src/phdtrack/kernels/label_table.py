"""The table of labels of `associate.labels`, frame by frame: counts, what is shown, and the rows.

A table is the columns of `associate.labels.LabelTable`, (a,) each, by label, ascending.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.coasting import Followed, Reported, after_frame, is_returning, on_box
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.small_arrays import first_not_below

Table = tuple[I8, I8, I8, F8, Bool]


@njit(**INNER)
def _new_labels(label: I8, tag: I8) -> I8:
    """The tags that are no label yet, each once, ascending."""
    new = np.empty(tag.size, np.int64)
    count = 0 * tag.size
    for k in range(tag.size):
        place = first_not_below(label, tag[k])
        if place < label.size and label[place] == tag[k]:
            continue
        at = first_not_below(new[:count], tag[k])
        if at < count and new[at] == tag[k]:
            continue
        for q in range(count, at, -1):
            new[q] = new[q - 1]
        new[at] = tag[k]
        count += 1
    return new[:count]


@njit(**INNER)
def _with_labels(table: Table, new: I8) -> Table:
    """The table with rows for new labels, ascending."""
    label, identity, states, last, confirmed = table
    n = label.size + new.size
    out = (
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
        np.empty(n, np.bool_),
    )
    i = j = 0 * n
    for k in range(n):
        if j == new.size or (i < label.size and label[i] < new[j]):
            out[0][k] = label[i]
            out[1][k] = identity[i]
            out[2][k] = states[i]
            out[3][k] = last[i]
            out[4][k] = confirmed[i]
            i += 1
        else:
            out[0][k] = new[j]
            out[1][k] = 0
            out[2][k] = 0
            out[3][k] = -np.inf
            out[4][k] = False
            j += 1
    return out


@njit(**MERGED)
def counted(
    table: Table, tag: I8, detection: I8, start: I8, time: F8, settled: int
) -> tuple[Table, I8, F8]:
    """The table after some moments, of which the first ``settled`` are never revised again; and the
    states and the last detection of each label with the others counted, too.

    ``tag``, ``detection`` (n,): of the states of all moments, one moment after the other; moment m
    begins at ``start[m]`` and has model time ``time[m]``. A label that has no row gets one.
    """
    new = _new_labels(table[0], tag)
    if new.size > 0:
        table = _with_labels(table, new)
    label, identity, states, last, confirmed = table
    states = states.copy()
    last = last.copy()
    # Moments are in order of time: of several states with a label the last one's stays.
    for m in range(settled):
        _count(label, tag, detection, start, time, m, states, last)
    all_states = states.copy()
    all_last = last.copy()
    for m in range(settled, time.size):
        _count(label, tag, detection, start, time, m, all_states, all_last)
    return (label, identity, states, last, confirmed), all_states, all_last


@njit(**ENTRY)
def counted_frame(
    table: Table,
    moments: tuple[I8, I8, I8, F8],
    settled: int,
    before: tuple[I8, F8, F8, F8, F8, F8],
    xyxy: F8,
    least: int,
    times: tuple[float, float, float, float, float],
    follows: bool,
) -> tuple[Table, I8, F8, tuple[I8, F8, F8, F8, F8, F8]]:
    """The results of `counted`, and of `followed_after` for the newest moment, in one call.

    ``moments``: labels, measurements, starts and times of `counted`. ``before``: the columns of
    `coasting.Followed`, which stay the same unless the newest moment ``follows``; ``xyxy`` (n, 4):
    of its states. ``least``, ``times``: see `followed_after`.
    """
    tag, detection, start, time = moments
    after, states, last = counted(table, tag, detection, start, time, settled)
    if follows:
        present = (after[0], after[1], states, last, after[4])
        now = followed_after(
            Followed(*before), present, tag[start[time.size - 1] :], xyxy, least, times
        )
        before = (now.label, now.last, now.age, now.xyxy, now.speed, now.verdicts)
    return after, states, last, before


@njit(**INNER)
def _count(
    label: I8, tag: I8, detection: I8, start: I8, time: F8, m: int, states: I8, last: F8
) -> None:
    """Count the states of moment m that rest on detections."""
    for k in range(start[m], start[m + 1]):
        if detection[k] >= 0:
            place = first_not_below(label, tag[k])
            states[place] += 1
            last[place] = time[m]


@njit(**MERGED)
def followed_after(
    before: Followed,
    present: Table,
    tag: I8,
    xyxy: F8,
    least: int,
    times: tuple[float, float, float, float, float],
) -> Followed:
    """The tracks that may be missing after a frame, see `coasting.after_frame`.

    ``present``: what is known of the labels now. ``tag`` (n,), ``xyxy`` (n, 4): of the frame's
    states. ``least``: states from which a label is confirmed. ``times``: the time units in a
    second; the time, the interval, the patience and the share kept of `coasting.after_frame`.
    """
    label, _, states, last, confirmed = present
    rate, now, interval, patience, kept = times
    n = tag.size
    order = np.empty(n, np.int64)
    when = np.empty(n)
    sure = np.empty(n, np.bool_)
    for k in range(n):
        place = first_not_below(label, tag[k])
        when[k] = last[place] / rate
        sure[k] = confirmed[place] or states[place] >= least
        # Mostly in order already.
        q = k
        while q > 0 and tag[order[q - 1]] > tag[k]:
            order[q] = order[q - 1]
            q -= 1
        order[q] = k
    reported = Reported(tag, order, xyxy, when, sure)
    after: Followed = after_frame(before, reported, now, interval, patience, kept)
    return after


@njit(**MERGED)
def coasting_rows(
    present: Table,
    tag: I8,
    detection: I8,
    verdicts: F8,
    rule: tuple[float, float, float, float],
    odds: tuple[float, float],
    least: int,
    flags: tuple[bool, bool],
) -> tuple[Bool, I8]:
    """(n,) whether each of a frame's states is shown though nothing was detected there, as far as
    its age decides; and which of these have no detection.

    Parameters
    ----------
    present, tag, detection : what is known of the labels; labels and measurements of the states.
    verdicts : of `coasting.is_returning`, with its prior and share ``odds``.
    rule : model time up to which the frame is known, and up to which the newest one is; the longest
        coast in model time; time units in a second.
    least : states from which a label is confirmed.
    flags : whether verdicts decide; whether a detector ran in the frame, without which only labels
        with an identity are shown.
    """
    label, identity, states, last, confirmed = present
    here, newest, longest, rate = rule
    by_evidence, observed = flags
    shown = np.empty(tag.size, np.bool_)
    unseen = np.empty(tag.size, np.int64)
    count = 0 * tag.size
    for k in range(tag.size):
        place = first_not_below(label, tag[k])
        coasts = here - last[place] <= longest
        if by_evidence:
            age = (newest - last[place]) / rate
            coasts = is_returning(verdicts, age, coasts, *odds) or last[place] >= here
        coasts = coasts and (confirmed[place] or states[place] >= least)
        if not observed:
            coasts = coasts and identity[place] > 0
        shown[k] = coasts
        if coasts and detection[k] < 0:
            unseen[count] = k
            count += 1
    return shown, unseen[:count]


@njit(**MERGED)
def shown_rows(
    present: Table,
    states: tuple[I8, I8, F8, F8],
    row: I8,
    coasts: Bool,
    least: int,
    number: int,
    used: int,
) -> tuple[I8, Bool, int, tuple[I8, I8, F8, F8, I8, Bool]]:
    """Identities (a,) and confirmed labels (a,) after a frame, the highest identity, and the
    columns of the frame's rows, by identity.

    Parameters
    ----------
    present : what is known of the labels.
    states : labels, measurements, boxes and weights of the frame's states.
    row : (N,) `Detections.row` of each measurement.
    coasts : (n,) whether each is shown without a detection.
    least, number : states from which a label is confirmed; the frame's number.
    used : the highest identity so far; new labels get the next ones.
    """
    label, identity, counts, _, confirmed = present
    tag, detection, xyxy, weight = states
    identity = identity.copy()
    sure = confirmed.copy()
    order = np.empty(tag.size, np.int64)
    n = 0 * tag.size
    for k in range(tag.size):
        if not (detection[k] >= 0 or coasts[k]):
            continue
        place = first_not_below(label, tag[k])
        if identity[place] == 0:
            used += 1
            identity[place] = used
        sure[place] = confirmed[place] or counts[place] >= least
        q = n
        while q > 0 and identity[first_not_below(label, tag[order[q - 1]])] > identity[place]:
            order[q] = order[q - 1]
            q -= 1
        order[q] = k
        n += 1
    out = (
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty((n, 4)),
        np.empty(n),
        np.empty(n, np.int64),
        np.empty(n, np.bool_),
    )
    for r in range(n):
        k = order[r]
        place = first_not_below(label, tag[k])
        out[0][r] = number
        out[1][r] = identity[place]
        for c in range(4):
            out[2][r, c] = xyxy[k, c]
        out[3][r] = weight[k] if weight[k] < 1.0 else 1.0
        out[4][r] = row[detection[k]] if detection[k] >= 0 else -1
        out[5][r] = sure[place]
    return identity, sure, used, out


@njit(**ENTRY)
def detected_rows(present: Table, tag: I8, detection: I8, row: I8, least: int) -> tuple[I8, Bool]:
    """(n,) `Detections.row` of each of a frame's states, −1 without a detection; and whether its
    label has been confirmed.

    ``present``, ``tag``, ``detection``, ``row``, ``least``: as of `shown_rows` and its ``states``.
    """
    label, _, counts, _, confirmed = present
    out = np.empty(tag.size, np.int64)
    sure = np.empty(tag.size, np.bool_)
    for k in range(tag.size):
        place = first_not_below(label, tag[k])
        out[k] = row[detection[k]] if detection[k] >= 0 else -1
        sure[k] = confirmed[place] or counts[place] >= least
    return out, sure


@njit(**MERGED)
def kept_labels(label: I8, last: F8, since: float, tag: I8) -> Bool:
    """(a,) whether each label was last detected ``since`` then, or is among the tags."""
    kept = np.empty(label.size, np.bool_)
    for place in range(label.size):
        kept[place] = last[place] >= since
    for k in range(tag.size):
        place = first_not_below(label, tag[k])
        if place < label.size and label[place] == tag[k]:
            kept[place] = True
    return kept


@njit(**ENTRY)
def due_rows(
    present: Table,
    states: tuple[I8, I8, F8, F8],
    boxes: tuple[F8, F8, F8],
    row: I8,
    verdicts: F8,
    rule: tuple[float, float, float, float],
    odds: tuple[float, float, float],
    numbers: tuple[int, int, int],
    flags: tuple[bool, bool, bool],
    kept: tuple[F8, float, I8],
) -> tuple[I8, Bool, int, tuple[I8, I8, F8, F8, I8, Bool], Bool]:
    """The rows of a frame that are due, in one call: `coasting_rows`, what it shows of boxes that
    are only predicted, `shown_rows` and `kept_labels`.

    Parameters
    ----------
    present, states, row : see `shown_rows`.
    boxes : states (d, n) and covariances (n, d, d), and (n,) the probability that each box lies on
        its target; (0,) for boxes in the image, of which it is computed.
    verdicts, rule : see `coasting_rows`.
    odds : its prior and share, and the probability from which a box that is only predicted is
        shown.
    numbers : states from which a label is confirmed; the frame's number; the highest identity.
    flags : whether states without a detection may be shown at all; those of `coasting_rows`.
    kept : the last detections (a,) that are settled, since when, and labels that are kept anyway.
    """
    tag, detection, _, weight = states
    state, covariance, chance = boxes
    least, number, used = numbers
    bridges, by_evidence, observed = flags
    last, since, open_tags = kept
    coasts = np.empty(tag.size, np.bool_)
    for k in range(tag.size):
        coasts[k] = False
    if bridges:
        coasts, unseen = coasting_rows(
            present,
            tag,
            detection,
            verdicts,
            rule,
            (odds[0], odds[1]),
            least,
            (by_evidence, observed),
        )
        if observed:
            for k in unseen:
                lies = chance[k] if chance.size > 0 else on_box(state, covariance, k)
                coasts[k] = weight[k] * lies > odds[2]
    identity, confirmed, used, columns = shown_rows(
        present, states, row, coasts, least, number, used
    )
    return (
        identity,
        confirmed,
        used,
        columns,
        kept_labels(present[0], last, since, open_tags),
    )
