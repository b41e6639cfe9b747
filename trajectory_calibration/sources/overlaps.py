# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that are of the same time: one run recorded twice, or two runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.sources import cdr
from trajectory_calibration.sources.topics import TopicTrack

# Two bags that have fewer messages in the time of both follow each other.
_FEWEST_SHARED = 5

# Where more than this share of them are the same, the bags are of one run.
_MOSTLY = 0.5


def without_repeats(parts: Sequence[tuple[str, TopicTrack]]) -> list[TopicTrack]:
    """Return what each bag holds of one topic, without the messages that another one holds, too.

    ``parts`` are what stands in one file each, with the name of its bag. Raise SourceError where
    two bags are of the same time, and their poses are not the same.
    """
    done: list[tuple[str, TopicTrack]] = []
    for bag, recorded in parts:
        track = recorded
        for other, before in done:
            # The files of one bag follow each other; of Paths only the last one counts.
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
    # The last messages of one bag may come late into the next.
    if end_ns <= start_ns or count < _FEWEST_SHARED:
        return track
    same = shared & np.isin(_rows(track), _rows(before))
    if np.count_nonzero(same) < _MOSTLY * count:
        raise SourceError(
            f'{track.topic}: {other} and {bag} overlap by {(end_ns - start_ns) * 1e-9:.1f} s with '
            'different poses: two runs? Give bags that follow each other, or calibrate each alone')
    note = f'{bag} repeats {counted(int(same.sum()), "message")} of {other}: used once'
    return replace(track.only(~same), notes=(*track.notes, note))


def _rows(track: TopicTrack) -> NDArray[np.void]:
    """Return the bytes of stamp and pose of each message."""
    rows = np.column_stack([track.stamps_ns.view(np.float64), track.poses])
    return rows.view(f'V{rows.itemsize * rows.shape[1]}').ravel()
