"""Tracks of one target that came back, under one identity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phdtrack.types import Tracks


def with_returns(
    tracks: Tracks, pairs: Sequence[tuple[tuple[int, int], tuple[int, int]]]
) -> Tracks:
    """The tracks with one identity for each two of the ``pairs``, named by the frame and the
    detection of a row of each; identities from 1 in order of appearance.

    Tracks with a frame in common stay two.
    """
    place = {
        (frame, row): identity
        for frame, row, identity in zip(
            tracks.frame.tolist(), tracks.detection.tolist(), tracks.identity.tolist(), strict=True
        )
        if row >= 0
    }
    identity = tracks.identity.copy()
    for ends in pairs:
        names = [place.get(end, 0) for end in ends]
        if 0 in names:
            continue
        rows = [np.flatnonzero(identity == identity[tracks.identity == name][0]) for name in names]
        if not np.intersect1d(tracks.frame[rows[0]], tracks.frame[rows[1]]).size:
            identity[rows[1]] = identity[rows[0][0]]
    if (identity == tracks.identity).all():
        return tracks
    names_, first, index = np.unique(identity, return_index=True, return_inverse=True)
    rank = np.empty(len(names_), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(1, len(names_) + 1)
    return Tracks.concatenate([replace(tracks, identity=rank[index])])
