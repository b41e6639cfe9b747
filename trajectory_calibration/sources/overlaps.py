# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that overlap in time: one run recorded twice, or two runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.sources import cdr
from trajectory_calibration.sources.topics import TopicTrack

# With fewer messages in the common time span, two bags are consecutive.
_FEWEST_SHARED = 5

# If at least this fraction of them is equal, both bags are of one run.
_MIN_EQUAL = 0.5


def without_repeats(parts: Sequence[tuple[str, TopicTrack]]) -> list[TopicTrack]:
    """Return the tracks of one topic without messages that an earlier bag contains, too.

    ``parts`` are bag name and track of each file. Raise SourceError if two bags overlap in time
    and their poses differ.
    """
    done: list[tuple[str, TopicTrack]] = []
    for bag, recorded in parts:
        track = recorded
        for other, before in done:
            # The files of one bag are consecutive; of Paths only the last one is used.
            if other != bag and track.msgtype != cdr.PATH:
                track = _without(track, before, bag, other)
        done.append((bag, track))
    return [track for _, track in done]


def _without(track: TopicTrack, before: TopicTrack, bag: str, other: str) -> TopicTrack:
    if not len(track.poses) or not len(before.poses):
        return track
    start_ns = max(track.stamps_ns.min(), before.stamps_ns.min())
    end_ns = min(track.stamps_ns.max(), before.stamps_ns.max())
    shared = (track.stamps_ns >= start_ns) & (track.stamps_ns <= end_ns)
    count = int(np.count_nonzero(shared))
    # The first messages of a bag may be late ones of the previous bag.
    if end_ns <= start_ns or count < _FEWEST_SHARED:
        return track
    equal = shared & np.isin(_rows(track), _rows(before))
    if np.count_nonzero(equal) < _MIN_EQUAL * count:
        raise SourceError(
            f'{track.topic}: {other} and {bag} overlap by {(end_ns - start_ns) * 1e-9:.1f} s with '
            'different poses: two runs? Give bags that follow each other, or calibrate each alone')
    note = f'{bag} repeats {counted(int(equal.sum()), "message")} of {other}: used once'
    return replace(track.only(~equal), notes=(*track.notes, note))


def _rows(track: TopicTrack) -> NDArray[np.void]:
    """Return (N,) the bytes of stamp and pose of each message, for comparison."""
    rows = np.column_stack([track.stamps_ns.view(np.float64), track.poses])
    return rows.view(f'V{rows.itemsize * rows.shape[1]}').ravel()
