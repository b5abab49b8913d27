"""The table of labels of `associate.labels`, frame by frame: counts, what is shown, and the rows.

A table (a,) of `LABEL` has a record for each label, ascending.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Bool, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.coasting import Followed, Reported, after_frame, is_returning, on_box
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.gaussian import records
from phdtrack.kernels.small_arrays import first_not_below

# A label: the model time of the last of its states that rest on detections, −∞ before the first;
# its number; its identity, 0 before its first row; its states that rest on detections; and whether
# it has been confirmed. As one array, because Python takes longer for each array than a kernel.
LABEL = records("last", "label identity states confirmed")
# The columns of `coasting.Followed`.
Missing = tuple[I8, F8, F8, F8, F8, F8]


@njit(**INNER)
def place_of(table: Records, label: int) -> int:
    """The first place in a table whose label is not below this one, or its length."""
    low = 0 * table.size
    high = table.size
    while low < high:
        middle = (low + high) // 2
        if table[middle].label < label:
            low = middle + 1
        else:
            high = middle
    return low


@njit(**MERGED)
def _new_labels(table: Records, tag: I8) -> I8:
    """The tags that are no label yet, each once, ascending."""
    new = np.empty(tag.size, np.int64)
    count = 0 * tag.size
    for k in range(tag.size):
        place = place_of(table, tag[k])
        if place < table.size and table[place].label == tag[k]:
            continue
        at = first_not_below(new[:count], tag[k])
        if at < count and new[at] == tag[k]:
            continue
        for q in range(count, at, -1):
            new[q] = new[q - 1]
        new[at] = tag[k]
        count += 1
    return new[:count]


@njit(**MERGED)
def _with_labels(table: Records, new: I8) -> Records:
    """The table with records for new labels, ascending."""
    n = table.size + new.size
    out = np.empty(n, LABEL)
    i = j = 0 * n
    for k in range(n):
        if j == new.size or (i < table.size and table[i].label < new[j]):
            out[k] = table[i]
            i += 1
        else:
            record = out[k]
            record.last = -np.inf
            record.label = new[j]
            record.identity = 0
            record.states = 0
            record.confirmed = 0
            j += 1
    return out


@njit(**INNER)
def _count(table: Records, tag: I8, detection: I8, time: float, begin: int, end: int) -> None:
    """Count the states ``begin`` … ``end`` − 1, of one moment, that rest on detections."""
    for k in range(begin, end):
        if detection[k] >= 0:
            record = table[place_of(table, tag[k])]
            record.states += 1
            record.last = time


@njit(**MERGED)
def counted(table: Records, moments: tuple[I8, I8, F8], settled: int) -> tuple[Records, Records]:
    """The table after some moments, of which the first ``settled`` are never revised again; and the
    same with the others counted, too.

    ``moments``: labels and measurements (n,) of the states of all, one moment after the other; the
    model times of the m moments, and then how many states each has (2m,). A label that has no
    record gets one.
    """
    tag, detection, numbers = moments
    after = _with_labels(table, _new_labels(table, tag))
    # Moments are in order of time: of several states with a label the last one's stays.
    many = numbers.size // 2
    begin = 0 * many
    for m in range(settled):
        end = begin + int(numbers[many + m])
        _count(after, tag, detection, numbers[m], begin, end)
        begin = end
    present = after.copy()
    for m in range(settled, many):
        end = begin + int(numbers[many + m])
        _count(present, tag, detection, numbers[m], begin, end)
        begin = end
    return after, present


@njit(**ENTRY)
def counted_frame(
    table: Records,
    moments: tuple[I8, I8, F8],
    settled: int,
    before: Missing,
    xyxy: F8,
    least: int,
    times: tuple[float, float, float, float, float],
    follows: bool,
) -> tuple[Records, Records, Missing]:
    """The results of `counted`, and of `followed_after` for the newest moment, in one call.

    ``before``: the columns of `coasting.Followed`, which stay the same unless the newest moment
    ``follows``; ``xyxy`` (n, 4): of its states. ``moments``, ``least``, ``times``: see `counted`
    and `followed_after`.
    """
    after, present = counted(table, moments, settled)
    if follows:
        tag = moments[0]
        now = followed_after(
            Followed(*before), present, tag[tag.size - len(xyxy) :], xyxy, least, times
        )
        before = (now.label, now.last, now.age, now.xyxy, now.speed, now.verdicts)
    return after, present, before


@njit(**MERGED)
def followed_after(
    before: Followed,
    present: Records,
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
    rate, now, interval, patience, kept = times
    n = tag.size
    order = np.empty(n, np.int64)
    when = np.empty(n)
    sure = np.empty(n, np.bool_)
    for k in range(n):
        known = present[place_of(present, tag[k])]
        when[k] = known.last / rate
        sure[k] = known.confirmed > 0 or known.states >= least
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
    present: Records,
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
    here, newest, longest, rate = rule
    by_evidence, observed = flags
    shown = np.empty(tag.size, np.bool_)
    unseen = np.empty(tag.size, np.int64)
    count = 0 * tag.size
    for k in range(tag.size):
        known = present[place_of(present, tag[k])]
        coasts = here - known.last <= longest
        if by_evidence:
            age = (newest - known.last) / rate
            coasts = is_returning(verdicts, age, coasts, *odds) or known.last >= here
        coasts = coasts and (known.confirmed > 0 or known.states >= least)
        if not observed:
            coasts = coasts and known.identity > 0
        shown[k] = coasts
        if coasts and detection[k] < 0:
            unseen[count] = k
            count += 1
    return shown, unseen[:count]


@njit(**MERGED)
def shown_rows(
    table: Records,
    present: Records,
    states: tuple[I8, I8, F8, F8],
    row: I8,
    coasts: Bool,
    least: int,
    number: int,
    used: int,
) -> tuple[Records, int, tuple[I8, I8, F8, F8, I8, Bool]]:
    """The table with identities and confirmed labels after a frame, the highest identity, and the
    columns of the frame's rows, by identity.

    Parameters
    ----------
    table, present : what is settled of the labels, and what is known of them.
    states : labels, measurements, boxes and weights of the frame's states.
    row : (N,) `Detections.row` of each measurement.
    coasts : (n,) whether each is shown without a detection.
    least, number : states from which a label is confirmed; the frame's number.
    used : the highest identity so far; new labels get the next ones.
    """
    tag, detection, xyxy, weight = states
    after = table.copy()
    for place in range(after.size):
        after[place].identity = present[place].identity
    order = np.empty(tag.size, np.int64)
    n = 0 * tag.size
    for k in range(tag.size):
        if not (detection[k] >= 0 or coasts[k]):
            continue
        place = place_of(after, tag[k])
        known = after[place]
        if known.identity == 0:
            used += 1
            known.identity = used
        if present[place].states >= least:
            known.confirmed = 1
        q = n
        while q > 0 and after[place_of(after, tag[order[q - 1]])].identity > known.identity:
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
        known = after[place_of(after, tag[k])]
        out[0][r] = number
        out[1][r] = known.identity
        for c in range(4):
            out[2][r, c] = xyxy[k, c]
        out[3][r] = weight[k] if weight[k] < 1.0 else 1.0
        out[4][r] = row[detection[k]] if detection[k] >= 0 else -1
        out[5][r] = known.confirmed > 0
    return after, used, out


@njit(**ENTRY)
def detected_rows(present: Records, tag: I8, detection: I8, row: I8, least: int) -> tuple[I8, Bool]:
    """(n,) `Detections.row` of each of a frame's states, −1 without a detection; and whether its
    label has been confirmed.

    ``present``, ``tag``, ``detection``, ``row``, ``least``: as of `shown_rows` and its ``states``.
    """
    out = np.empty(tag.size, np.int64)
    sure = np.empty(tag.size, np.bool_)
    for k in range(tag.size):
        known = present[place_of(present, tag[k])]
        out[k] = row[detection[k]] if detection[k] >= 0 else -1
        sure[k] = known.confirmed > 0 or known.states >= least
    return out, sure


@njit(**MERGED)
def remembered(table: Records, since: float, tag: I8) -> Records:
    """The table without the labels that were not detected ``since`` then and are none of the
    tags.
    """
    kept = np.empty(table.size, np.bool_)
    count = 0 * table.size
    for place in range(table.size):
        kept[place] = table[place].last >= since
        count += kept[place]
    for k in range(tag.size if count < table.size else 0):
        place = place_of(table, tag[k])
        if place < table.size and table[place].label == tag[k]:
            kept[place] = True
    out = np.empty(table.size, LABEL)
    count = 0 * table.size
    for place in range(table.size):
        if kept[place]:
            out[count] = table[place]
            count += 1
    return out[:count]


@njit(**ENTRY)
def due_rows(
    tables: tuple[Records, Records],
    states: tuple[I8, I8, F8, F8],
    boxes: tuple[F8, F8, F8],
    row: I8,
    verdicts: F8,
    rule: tuple[float, float, float, float],
    odds: tuple[float, float, float],
    numbers: tuple[int, int, int],
    flags: tuple[bool, bool, bool],
    open_labels: tuple[float, I8],
) -> tuple[Records, int, tuple[I8, I8, F8, F8, I8, Bool]]:
    """The rows of a frame that are due, in one call: `coasting_rows`, what it shows of boxes that
    are only predicted, `shown_rows` and `remembered`.

    Parameters
    ----------
    tables : what is settled of the labels, and what is known of them.
    states, row : see `shown_rows`.
    boxes : states (d, n) and covariances (n, d, d), and (n,) the probability that each box lies on
        its target; (0,) for boxes in the image, of which it is computed.
    verdicts, rule : see `coasting_rows`.
    odds : its prior and share, and the probability from which a box that is only predicted is
        shown.
    numbers : states from which a label is confirmed; the frame's number; the highest identity.
    flags : whether states without a detection may be shown at all; those of `coasting_rows`.
    open_labels : see `remembered`.
    """
    table, present = tables
    tag, detection, _, weight = states
    state, covariance, chance = boxes
    least, number, used = numbers
    bridges, by_evidence, observed = flags
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
    after, used, columns = shown_rows(table, present, states, row, coasts, least, number, used)
    return remembered(after, open_labels[0], open_labels[1]), used, columns
