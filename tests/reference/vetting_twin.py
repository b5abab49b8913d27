"""Who is believed, with a dictionary."""

from __future__ import annotations

import numpy as np


def unbelieved(known, odds, identity, detection, confirmed, xyxy, sure):
    """As `kernels.vetting.unbelieved`."""
    told = dict(zip(known.tolist(), odds.T.tolist(), strict=True))
    least = np.array([told.get(i, [np.inf, np.inf]) for i in identity.tolist()]).reshape(-1, 2).T
    believed = (confirmed & (least[0] < 0)) | (least[1] < sure)
    which = np.flatnonzero(~believed & (detection >= 0))
    left, top, right, bottom = xyxy[which].T
    z = np.array([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top])
    return believed, which, least[:, which], z


def remembered(known, odds, identity, confirmed, believed, which, least, now, sure, most):
    """As `kernels.vetting.remembered`."""
    lowest = np.minimum(least, now)
    told = dict(zip(known.tolist(), odds.T.tolist(), strict=True))
    told |= dict(zip(identity[which].tolist(), lowest.T.tolist(), strict=True))
    believed = believed.copy()
    believed[which] = (confirmed[which] & (lowest[0] < 0)) | (lowest[1] < sure)
    spare = [i for i in sorted(told) if i not in identity.tolist()][: max(len(told) - most, 0)]
    left = [i for i in sorted(told) if i not in spare]
    return np.array(left, np.int64), np.array([told[i] for i in left]).reshape(-1, 2).T, believed
