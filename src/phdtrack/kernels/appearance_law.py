"""The meaning of similarity by the lessons of a stream (docs/methods.md, Appearance) [APP (3)],
[APP (4)].
"""

from __future__ import annotations

import math
from typing import Any

from phdtrack.kernels import F4, F8
from phdtrack.kernels.appearance import UNKNOWN, described
from phdtrack.kernels.appearance_lessons import changed_share, named_lessons
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Lessons that are worth one: those of one target are not independent.
ALIKE = 5.0
# The least deviation of similarity, and for how many lessons the usual one counts.
LEAST_DEVIATION = 0.03
USUAL_DEVIATION = 0.15
USUAL_FOR = 5.0
# What evidence of pictures counts for where motion leaves doubt: what hides parts of objects makes
# them worse there than where the lessons come from.
TRUST = 0.5
# Seconds for which errors of descriptors usually last; lessons of single descriptors for which the
# usual values count, and the usual signal.
USUAL_INDEPENDENT = 0.5
PRIOR_SINGLE = 20.0
USUAL_SIGNAL = 0.6
# Of the meetings at which two change looks this part is seen beside each other thereafter.
SEEN_CHANGED = 0.08
# The share of changed looks up to which looks are believed fully: half of what is expected at
# first, so that meetings must have shown it.
TRUSTED = 0.005
_UNKNOWN = tuple(UNKNOWN[:-1])


@njit(**ENTRY)
def looks_and_law(
    raw: F4,
    boxes: F8,
    mean: F4,
    count: float,
    most: float,
    sums: F8,
    rules: tuple[float, float, float],
) -> tuple[Any, ...]:
    """`kernels.appearance.described` of a frame, and `law_of` lessons, in one call.

    Parameters
    ----------
    raw, boxes, mean, count, most : as of `kernels.appearance.described`.
    sums, rules : the arguments of `law_of`.
    """
    return described(raw, boxes, mean, most, count), law_of(sums, *rules)


@njit(**ENTRY)
def law_of(sums: F8, prior: float, within: float, alike: float) -> tuple[float, ...]:
    """The fields of `kernels.appearance.Law`.

    Parameters
    ----------
    sums : those of `kernels.appearance_lessons.lessons_of` so far.
    prior : lessons for which it counts that appearance says nothing.
    within : `Law.within`.
    alike : lessons of means that are worth one.
    """
    lessons = named_lessons(sums)
    number, x, xx, s, xs, ss = lessons.same
    others, t, tt = lessons.other
    if min(number, others) <= 0.0:
        return (*_UNKNOWN, within)
    spread = xx - x * x / number
    fading = min((xs - x * s / number) / (spread + 1.0), 0.0)
    same = (s - fading * x) / number
    rest = ss - 2 * (same * s + fading * xs) + number * same**2
    rest += fading * (2 * same * x + fading * xx)
    variance = _variance(rest, number)
    other = t / others
    other_variance = _variance(tt - others * other**2, others)
    value = worth((number, same, variance), (others, other, other_variance), prior, ALIKE)
    changed = changed_share(lessons.beside)
    trust = _trust(changed)
    independent, signal, near_deviation = _noise(lessons.single)
    return (
        TRUST * trust * value,
        same,
        fading,
        _deviation(variance),
        other,
        _deviation(other_variance),
        independent,
        signal,
        near_deviation,
        *_means(lessons.means, prior, alike, trust),
        max(math.log(changed / TRUSTED), 0.0),
        within,
    )


@njit(**INNER)
def _variance(squares: float, number: float) -> float:
    """The variance by a sum of squares of so many lessons."""
    usual = USUAL_FOR * USUAL_DEVIATION**2
    return (max(squares, 0.0) + usual) / (number + USUAL_FOR)


@njit(**INNER)
def _deviation(variance: float) -> float:
    """The deviation, at least the least one."""
    return max(math.sqrt(variance), LEAST_DEVIATION)


@njit(**INNER)
def worth(
    same: tuple[float, float, float],
    other: tuple[float, float, float],
    prior: float,
    alike: float,
) -> float:
    """How much similarity is worth, from 0 to 1: the less, the nearer to its standard error the
    difference of the two means is (James and Stein), and the fewer lessons there were.

    ``same``, ``other``: number of lessons, mean and variance of the similarity of one object, and
    of two. ``prior``: as of `law_of`. ``alike``: lessons that are worth one.
    """
    number, mean, variance = same
    others, other_mean, other_variance = other
    difference = mean - other_mean
    if difference <= 0.0:
        return 0.0
    error = alike * (variance / number + other_variance / others)
    least = min(number, others)
    certain = max(1 - error / difference**2, 0.0)
    return certain * least / (least + prior)


@njit(**INNER)
def _trust(changed: float) -> float:
    """The part of the evidence of looks that is left, from 0 to 1, where the looks of targets that
    meet have ``changed``, as of `changed_share`.

    If looks change places at a meeting with probability ε, then all that two targets look like
    after it is worth no more than log (1 − ε)/ε [APP (7)].
    """
    if changed <= TRUSTED:
        return 1.0
    chance = changed / SEEN_CHANGED
    if chance >= 0.5:
        return 0.0
    usual = TRUSTED / SEEN_CHANGED
    return math.log(1.0 / chance - 1.0) / math.log(1.0 / usual - 1.0)


@njit(**INNER)
def _means(
    means: F8, prior: float, alike: float, trust: float
) -> tuple[float, float, float, float, float]:
    """`Law.means_weight` and what follows it, but for ``within``."""
    number, s, ss, others, t, tt = means
    if min(number, others) <= 0.0:
        return 0.0, 1.0, 1.0, 0.0, 1.0
    same = s / number
    other = t / others
    variance = _variance(ss - number * same**2, number)
    other_variance = _variance(tt - others * other**2, others)
    return (
        trust * worth((number, same, variance), (others, other, other_variance), prior, alike),
        same,
        _deviation(variance),
        other,
        _deviation(other_variance),
    )


@njit(**INNER)
def _noise(single: F8) -> tuple[float, float, float]:
    """Seconds for which errors of descriptors last, the part of a single descriptor's variance that
    is the object's own, and the deviation of the similarity of neighbouring ones [APP (4)].
    """
    near, apart, alike, far, long_after, squares = single
    signal = (long_after + PRIOR_SINGLE * USUAL_SIGNAL) / (far + PRIOR_SINGLE)
    signal = min(max(signal, 0.05), 0.95)
    if near <= 0.0:
        return USUAL_INDEPENDENT, signal, USUAL_DEVIATION
    rho = (alike / near - signal) / (1 - signal)
    rho = min(max(rho, 0.001), 0.98)
    seconds = -(apart / near) / math.log(rho)
    share = near / (near + PRIOR_SINGLE)
    seconds = math.exp(share * math.log(seconds) + (1 - share) * math.log(USUAL_INDEPENDENT))
    return seconds, signal, _deviation(_variance(squares - alike**2 / near, near))
