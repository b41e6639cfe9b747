# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which pose of a belongs to which pose of b: association in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.pose_pairs import AssociationSummary, MIN_PAIRS, PosePairs
from trajectory_calibration.data.trajectory import ROUNDING_TOLERANCE, Trajectory
from trajectory_calibration.errors import AssociationError, counted
from trajectory_calibration.geometry.interpolation import interpolate, left_of

# Stamps closer than this are one instant: rounding to microseconds.
COINCIDENCE_NS = 1_000_000

# Share of unpaired poses from which on there is a finding.
UNPAIRED_SHARE = 0.1


def associate(
    a: Trajectory, b: Trajectory, config: CalibrationConfig | None = None, time_offset_ns: int = 0,
) -> PosePairs:
    """Pair the poses of two trajectories over their common time span, by ``config.association``.

    That is 'nearest' (``associate_nearest``), 'interpolate' (``associate_by_interpolation``) or
    'auto'. 'auto' interpolates the trajectory with the higher rate, or a if they are similar.
    If at least half of the poses of the other one lie within 10 ms of a pose, or in a gap of at
    most 0.15 s, only these are used: keyframes with a common trigger need no interpolation.
    ``time_offset_ns`` is added to the stamps of b.

    Raise AssociationError if they do not overlap in time or give fewer than three pairs.
    """
    config = config or CalibrationConfig()
    method, max_gap_ns = config.association, round(config.max_gap * 1e9)
    if method == 'nearest':
        return associate_nearest(
            a, b, max_difference_ns=round(config.max_time_difference * 1e9),
            time_offset_ns=time_offset_ns)
    if method == 'auto' and is_sparser(a.stamps_ns, b.stamps_ns):
        # Checked here, because the message names an offset to add to the stamps of b.
        _require_overlap(a, b.stamps_ns + time_offset_ns, b.sensor_frame, time_offset_ns)
        pairs = associate_by_interpolation(
            b, a, max_gap_ns=max_gap_ns, time_offset_ns=-time_offset_ns, prefer_near=True)
        return _swapped(pairs, time_offset_ns)
    return associate_by_interpolation(
        a, b, max_gap_ns=max_gap_ns, time_offset_ns=time_offset_ns,
        prefer_near=method == 'auto')


def is_sparser(stamps_a: NDArray[np.int64], stamps_b: NDArray[np.int64]) -> bool:
    """Return whether 'auto' interpolates b at the stamps of a, not a at those of b."""
    if min(len(stamps_a), len(stamps_b)) < 2:
        return False
    step_a, step_b = (np.median(np.diff(stamps)) for stamps in (stamps_a, stamps_b))
    # Chords between sparse poses are shorter than the path, which would pass for a scale error.
    return bool(step_a > 1.5 * step_b)


def _swapped(pairs: PosePairs, time_offset_ns: int) -> PosePairs:
    """Exchange a and b in pairs, and change from the clock of b to that of a."""
    summary = replace(
        pairs.summary, time_offset_s=time_offset_ns * 1e-9, poses_a=pairs.summary.poses_b,
        poses_b=pairs.summary.poses_a, stamps_of='a')
    return PosePairs(pairs.stamps_ns + time_offset_ns, pairs.poses_b, pairs.poses_a, summary)


def associate_nearest(
    a: Trajectory, b: Trajectory, *, max_difference_ns: int, time_offset_ns: int = 0,
) -> PosePairs:
    """Pair each pose of b with the nearest of a, one to one, within ``max_difference_ns``.

    Two poses are paired if each is the nearest of the other, so no pose is in two pairs. The
    stamps of the pairs are those of b in the clock of a.
    """
    stamps_b = b.stamps_ns + time_offset_ns
    _require_overlap(a, stamps_b, b.sensor_frame, time_offset_ns)
    nearest_a = _nearest(a.stamps_ns, stamps_b)
    nearest_b = _nearest(stamps_b, a.stamps_ns)
    mutual = nearest_b[nearest_a] == np.arange(len(b))
    near = np.abs(a.stamps_ns[nearest_a] - stamps_b) <= max_difference_ns
    j = np.flatnonzero(mutual & near)
    summary = _summarise('nearest', a, stamps_b, j, time_offset_ns, near=near)
    _require_pairs(summary, a, b, f'no closer than {max_difference_ns * 1e-9:g} s; raise '
                   'max_time_difference, set time_offset, or use interpolation')
    return PosePairs(stamps_b[j], a.poses[nearest_a[j]], b.poses[j], summary)


def associate_by_interpolation(
    a: Trajectory, b: Trajectory, *, max_gap_ns: int | None, time_offset_ns: int = 0,
    prefer_near: bool = False,
) -> PosePairs:
    """Evaluate a at the stamps of b, as ``interpolation.interpolate`` does.

    Only inside the span of a, and only between poses of a at most ``max_gap_ns`` apart (None:
    any gap), because a vehicle does not hold its twist over seconds. A pose of b that
    coincides with one of a needs no neighbour and is kept whatever the gap.

    ``prefer_near`` keeps to the poses of b within 10 ms of one of a, or in a gap of at most
    0.15 s, where these are at least half of all.
    """
    stamps_b = b.stamps_ns + time_offset_ns
    _require_overlap(a, stamps_b, b.sensor_frame, time_offset_ns)
    left = left_of(a.stamps_ns, stamps_b)
    gap = a.stamps_ns[left + 1] - a.stamps_ns[left]
    since_left = stamps_b - a.stamps_ns[left]
    to_nearest = np.minimum(np.abs(since_left), np.abs(gap - since_left))
    bridged = np.ones(len(b), bool) if max_gap_ns is None else gap <= max_gap_ns
    bridged |= to_nearest <= COINCIDENCE_NS
    inside = _inside(a, stamps_b)
    usable = inside & bridged
    # Over more than 1.5 steps at 10 Hz the velocity changes, and the interpolation error outweighs
    # the additional poses.
    near = usable & ((to_nearest <= 10_000_000) | (gap <= 150_000_000))
    between = 0
    if prefer_near and near.sum() >= 0.5 * usable.sum():
        between = int(np.count_nonzero(usable & ~near))
        usable = near
    j = np.flatnonzero(usable)
    poses_a = interpolate(a.stamps_ns, a.poses, stamps_b[j], max_gap_ns=max_gap_ns)
    summary = _summarise(
        'interpolate', a, stamps_b, j, time_offset_ns, near=bridged, between=between)
    _require_pairs(summary, a, b, f'{summary.in_gaps} fall in gaps of {a.sensor_frame} longer '
                   f'than {(max_gap_ns or 0) * 1e-9:g} s. {_advice(a.stamps_ns, stamps_b)}')
    return PosePairs(stamps_b[j], poses_a, b.poses[j], summary)


def _nearest(sorted_stamps: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return for each query the index of the nearest of at least two sorted stamps."""
    right = left_of(sorted_stamps, queries) + 1
    left_is_nearer = queries - sorted_stamps[right - 1] <= sorted_stamps[right] - queries
    return right - left_is_nearer


def _inside(a: Trajectory, stamps_b: NDArray[np.int64]) -> NDArray[np.bool_]:
    return (stamps_b >= a.stamps_ns[0]) & (stamps_b <= a.stamps_ns[-1])


def _require_overlap(
    a: Trajectory, stamps_b: NDArray[np.int64], name_b: str, time_offset_ns: int,
) -> None:
    start_a, end_a = int(a.stamps_ns[0]), int(a.stamps_ns[-1])
    start_b, end_b = int(stamps_b[0]), int(stamps_b[-1])
    if start_b <= end_a and start_a <= end_b:
        return
    order = (f'{a.sensor_frame} ends at {end_a * 1e-9:.3f} s, {name_b} starts at '
             f'{start_b * 1e-9:.3f} s' if end_a < start_b else
             f'{name_b} ends at {end_b * 1e-9:.3f} s, {a.sensor_frame} starts at '
             f'{start_a * 1e-9:.3f} s')
    offset = (start_a - start_b) * 1e-9
    raise AssociationError(
        f'no overlap in time: {order}. If both recordings of one drive began together, set '
        f'time_offset to about {offset + time_offset_ns * 1e-9:.3f}')


def _require_pairs(summary: AssociationSummary, a: Trajectory, b: Trajectory, why: str) -> None:
    fewest = min(a, b, key=len)
    if len(fewest) < MIN_PAIRS:
        raise AssociationError(
            f'only {counted(len(fewest), "pose")} of {fewest.sensor_frame}, needed at least '
            f'{MIN_PAIRS}; record longer, or give the whole file')
    if summary.pairs < MIN_PAIRS:
        raise AssociationError(
            f'only {counted(summary.pairs, "pose pair")} of {summary.poses_a} and '
            f'{summary.poses_b} poses ({summary.outside} outside the common time), needed at '
            f'least {MIN_PAIRS}; {why}')


def _advice(stamps_a: NDArray[np.int64], stamps_b: NDArray[np.int64]) -> str:
    """Return the settings that pair poses whose gaps are too long to interpolate."""
    apart_s = 1e-9 * float(np.abs(stamps_a[_nearest(stamps_a, stamps_b)] - stamps_b).max())
    step_s = 1e-9 * float(np.median(np.diff(stamps_a)))
    # Rounded up, so that the setting that is named suffices.
    apart, step = (np.ceil(100 * seconds) / 100 for seconds in (apart_s, step_s))
    if apart >= step:
        return ('Raise max_gap, set time_offset, or leave it to association auto which sensor is '
                'interpolated')
    return ('If the sensors stood still at each pose: --association=nearest '
            f'--max-time-difference={apart:g}. If they moved: --max-gap={step:g}')


def _summarise(
    method: str, a: Trajectory, stamps_b: NDArray[np.int64], paired: NDArray[np.intp],
    time_offset_ns: int, *, near: NDArray[np.bool_], between: int = 0,
) -> AssociationSummary:
    """Count the (N,) poses of b; ``near`` is true where a pose of a is near enough."""
    inside = _inside(a, stamps_b)
    difference = np.abs(a.stamps_ns[_nearest(a.stamps_ns, stamps_b[paired])] - stamps_b[paired])
    return AssociationSummary(
        method=method,
        time_offset_s=time_offset_ns * 1e-9,
        poses_a=len(a),
        poses_b=len(stamps_b),
        pairs=len(paired),
        outside=int(np.count_nonzero(~inside)),
        in_gaps=int(np.count_nonzero(inside & ~near)),
        between=between,
        median_difference_s=float(np.median(difference)) * 1e-9 if len(paired) else 0.0,
        max_difference_s=float(difference.max(initial=0)) * 1e-9,
    )


def association_findings(
    pairs: PosePairs, a: Trajectory, b: Trajectory,
) -> tuple[Finding, ...]:
    """Return findings about many unpaired poses, identical poses and equal frame names."""
    found, summary = [], pairs.summary
    one, other = (b, a) if summary.stamps_of == 'b' else (a, b)
    for code, count, where in (
            ('association-gaps', summary.in_gaps, f'fall in gaps of {other.sensor_frame}'),
            ('association-outside', summary.outside,
             f'lie outside the time of {other.sensor_frame}')):
        share = count / len(one)
        if share > UNPAIRED_SHARE:
            found.append(Finding(
                code, f'{share:.0%} of the poses of {one.sensor_frame} {where}: unused',
                {'share': share}))
    # The same poses in another format or at another rate differ by rounding.
    if np.median(np.abs(pairs.poses_a - pairs.poses_b).max(axis=(1, 2))) < ROUNDING_TOLERANCE:
        found.append(Finding(
            'poses-identical', f'{a.sensor_frame} and {b.sensor_frame} report identical poses: '
            'the answer is the pose of a sensor in itself. Check that two sensors were given'))
    if a.sensor_frame == b.sensor_frame:
        found.append(Finding(
            'frames-equal', f'both sensors are named {a.sensor_frame}: name their frames before '
            'publishing the transform'))
    return tuple(found)
