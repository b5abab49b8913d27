"""Errors of identity: a track takes another object, or an object goes on under another track.

The mapping is that of MOTA (`matching.tracking_mapping`). An object follows from its mapped boxes
one track after the other, and a track one object after the other. Each change is one of

* swap: two tracks exchange their objects. Track A goes from object g to h, and is the next track of
  h; track B goes from h to g, and is the next track of g. Both go over once, at any two times;
* transfer: any other change of a track from one object to another. So three tracks that exchange
  their objects in a ring are three transfers;
* break: any other change of an object from one track to another. Its new track has followed no
  object before, or this one.

Every switch that MOTA counts belongs to exactly one error, two to each swap. A transfer is no
switch if its object had no track before, or this one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.metrics.matching import Matches, SequencePair
from phdtrack.types import I8

KINDS = ("swap", "transfer", "break")


class IdentityError(NamedTuple):
    """An error of identity.

    Attributes
    ----------
    kind : one of `KINDS`.
    frame : the first frame after the change.
    objects, tracks : identities. Of a swap the two tracks, and the object that each had before; of
        a transfer the track, and its two objects in order; of a break the object, and its two
        tracks in order.
    boxes : how many boxes it takes out of their identity: the fewer of those in a row before and
        after the change, summed over both tracks of a swap.
    """

    kind: str
    frame: int
    objects: tuple[int, ...]
    tracks: tuple[int, ...]
    boxes: int


class _Chain(NamedTuple):
    """The K mapped pairs along each object, or along each track.

    ``before``, ``after`` (K,): the neighbours of each pair, −1 for none. ``until``, ``since`` (K,):
    how many pairs of the same two are in a row up to it, and from it on, itself included.
    """

    before: I8
    after: I8
    until: I8
    since: I8

    @classmethod
    def along(cls, name: I8, other: I8) -> _Chain:
        """The pairs (K,), frames ascending, along each ``name``; ``other`` is the other side."""
        count = len(name)
        order = np.argsort(name, kind="stable")
        same = np.diff(name[order]) == 0
        before, after, until, since = np.full((4, count), -1)
        before[order[1:]] = np.where(same, order[:-1], -1)
        after[order[:-1]] = np.where(same, order[1:], -1)
        begins = np.flatnonzero(np.append(True, ~same | (np.diff(other[order]) != 0))[:count])
        length = np.diff(np.append(begins, count))
        place = np.arange(count) - np.repeat(begins, length)
        until[order] = place + 1
        since[order] = np.repeat(length, length) - place
        return cls(before, after, until, since)


def identity_errors(sequence: SequencePair, mapping: Matches) -> tuple[IdentityError, ...]:
    """The errors of identity, frames ascending.

    Parameters
    ----------
    sequence, mapping : of the tracks, by `matching.tracking_mapping`.
    """
    by_object = _Chain.along(mapping.truth, mapping.output)
    by_track = _Chain.along(mapping.output, mapping.truth)
    from_track = by_object.before
    from_object = by_track.before
    switched = (from_track >= 0) & (mapping.output[from_track] != mapping.output)
    jumped = (from_object >= 0) & (mapping.truth[from_object] != mapping.truth)
    # Where the old track of a pair's object goes next: in a swap to the old object of its track.
    partner = np.where(switched & jumped, by_track.after[from_track], -1)
    swapped = (partner >= 0) & (by_object.before[partner] == from_object)
    partner = np.where(swapped, partner, -1)
    number = np.array([pair.number for pair in sequence.pairs], np.int64)
    frame = number[mapping.position]
    lost_by_object = np.minimum(by_object.until[from_track], by_object.since)
    lost_by_track = np.minimum(by_track.until[from_object], by_track.since)
    objects = sequence.truth_identity[mapping.truth]
    tracks = sequence.output_identity[mapping.output]
    errors = list[IdentityError]()
    for k in np.flatnonzero(switched | jumped).tolist():
        one = int(objects[k])
        track = int(tracks[k])
        when = int(frame[k])
        if swapped[k]:
            other = int(partner[k])
            if other > k:
                boxes = int(lost_by_object[k] + lost_by_object[other])
                both = (int(objects[other]), one)
                errors.append(IdentityError("swap", when, both, (track, int(tracks[other])), boxes))
        elif jumped[k]:
            both = (int(objects[from_object[k]]), one)
            errors.append(IdentityError("transfer", when, both, (track,), int(lost_by_track[k])))
        else:
            both = (int(tracks[from_track[k]]), track)
            errors.append(IdentityError("break", when, (one,), both, int(lost_by_object[k])))
    return tuple(errors)
