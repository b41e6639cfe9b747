# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks before the solver: both trajectories are of one vehicle, and are read correctly.

A solver returns an extrinsic for any two trajectories: also for those of two vehicles, for
inverted poses, for quaternions in another order. Its residuals then look like noise. The limits
here are relative to the motion and to what independent errors explain, not fixed angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from trajectory_calibration.assessment.answer_checks import two_worlds
from trajectory_calibration.assessment.metrics import RelativeErrors
from trajectory_calibration.assessment.offset_steadiness import offset_steadiness
from trajectory_calibration.assessment.orientation_checks import (
    least_steps,
    require_orientation,
)
from trajectory_calibration.assessment.rigid_fit import (
    best_fit,
    fits,
    growth,
    NOT_BY_NOISE,
    ONE_BODY,
    Read,
    RigidFit,
    rotation_share,
)
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError, counted, MotionError, rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import (
    noise_identifier,
    solver_info,
    solvers_that_estimate,
)
from trajectory_calibration.time_alignment.align import match
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection

# Another reading of the poses is the explanation if it reduces the misfit to this share. Readings
# are tried only above this misfit. It is low, because a vehicle that hardly rolls and pitches
# looks similar in all readings.
_LITTLE = 0.2

# Rotations (radians) that pose errors of a stationary vehicle may reach.
_STATIONARY = np.deg2rad(1.0)

# Residuals above this share of the motion at every lag are not those of one body.
_NOT_COMMON = 0.5

# Ratio of the motion as read to the inverted one: mean of both trajectories, and each of them.
_INVERTED, _INVERTED_EACH = 1.15, 1.1

# The clock offset of one vehicle scatters along a drive by less than this, seconds.
_LARGEST_SCATTER_S = 0.025
# The largest clock offset, seconds, that is tried if the two do not rotate together.
_FAR_OFFSET = 60.0


def check_orientations(a: Trajectory, b: Trajectory, config: CalibrationConfig) -> None:
    """Raise MotionError if one of them has no measured orientation."""
    if config.input_checks:
        require_orientation(a)
        require_orientation(b)


def check_pairs(
    pairs: PosePairs, a: Trajectory, b: Trajectory, clock: ClockCorrection,
    config: CalibrationConfig,
) -> tuple[Finding, ...]:
    """Raise MotionError if the two cannot be sensors of one vehicle; return findings.

    ``pairs`` are the pose pairs of a and b for ``clock`` and ``config``.
    """
    if not config.input_checks:
        return ()
    found = best_fit(pairs)
    if found is None:
        return ()
    if found.misfit > _LITTLE:
        _refuse_mirrored(found, pairs, f'{a.sensor_frame} and {b.sensor_frame}')
        _refuse_other_reading(found, pairs, a, b, config)
    if not found.one_body:
        _refuse_two_bodies(pairs, a, b, config)
    elif _are_inverted(pairs, a, b):
        raise MotionError(
            f'{a.sensor_frame} and {b.sensor_frame} seem to hold inverted poses (of the world in '
            'the sensor): both move too far. Use --invert-a --invert-b, or --no-input-checks if '
            'they are right')
    return _steady(a, b, clock, config)


def require_fit(T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str], solver: str) -> None:
    """Raise MotionError if the rotation of a solver does not fit rotations that agree.

    A method that weighs rotation and translation together may sacrifice the rotation if the two
    trajectories have different scales.
    """
    best = best_fit(pairs)
    if best is None or not best.one_body:
        return
    share = rotation_share(pairs, best.lag, T_a_b[:3, :3])
    if share <= best.rotation_share + ONE_BODY['rotation']:
        return
    scale = 'give it (scale)'
    if 'scale' not in solver_info(solver).estimates:
        scale += f', or use solver {" or ".join(solvers_that_estimate("scale"))}, which finds it'
    raise MotionError(
        f'the rotation that {solver} found does not fit: half of the rotations differ by '
        f'{share:.0%}, at best by {best.rotation_share:.1%}: {frames[0]} and {frames[1]} did turn '
        f'together. Check the unit and scale of both; {scale}')


def short_drive(pairs: PosePairs, metrics: RelativeErrors) -> tuple[Finding, ...]:
    """Return a warning if the drive is too short to separate SLAM errors from motion.

    The standard deviations are then too small. ``metrics`` tell whether there are errors at all.
    """
    span_s = float(pairs.stamps_ns[-1] - pairs.stamps_ns[0]) * 1e-9
    # Standard deviations of drives below 20 s were measured to be too small (docs/uncertainty.md).
    if span_s >= 20 or max(metrics.e_rt, metrics.e_rR) < se3.PRECISION:
        return ()
    return (Finding(
        'short-drive', f'only {rounded(span_s)} s of common motion: errors that grow over longer '
        'times do not show, and the standard deviations may be too small. Record a minute or more',
        {'duration_s': span_s}),)


def orientation_jumps(pairs: PosePairs) -> tuple[Finding, ...]:
    """Return a warning if the rotation angles of both sensors differ strongly in single steps.

    A SLAM that restarts, for instance between two bags, has a new world frame, so motions across
    the restart are invalid. The rotation angle does not depend on the extrinsic. For solvers that
    do not find jumps themselves.
    """
    angle_a, angle_b = (
        se3.rotation_angle(np.swapaxes(R[:-1], 1, 2) @ R[1:])
        for R in (pairs.poses_a[:, :3, :3], pairs.poses_b[:, :3, :3]))
    difference = np.abs(angle_a - angle_b)
    found = np.flatnonzero(
        difference > max(np.deg2rad(10), 20 * float(np.median(difference))))
    if not len(found):
        return ()
    k = int(found[difference[found].argmax()])
    since_s = (pairs.stamps_ns[k] - pairs.stamps_ns[0]) * 1e-9
    return (Finding(
        'orientation-jumps', f'{counted(len(found), "orientation jump")} (largest '
        f'{rounded(np.rad2deg(difference[k]))} deg at {since_s:.1f} s): SLAM restart or loop '
        'closure? '
        f'Use {noise_identifier().name}, which excludes them, or calibrate the parts separately',
        {'steps': len(found), 'largest_deg': float(np.rad2deg(difference[k]))}),)


def _are_inverted(pairs: PosePairs, a: Trajectory, b: Trajectory) -> bool:
    """Return whether both hold inverted poses (of the world in the sensor).

    These satisfy the equations as well; the answer is then the pose of one world in the other.
    """
    steps = [least_steps(trajectory) for trajectory in (a, b)]
    if not all(step > _INVERTED_EACH * inverted for step, inverted in steps):
        return False
    fit = best_fit(pairs, se3.inverse, se3.inverse)
    both_as_read, both_inverted = np.prod(steps, axis=0)
    # Pose errors are no motion.
    return bool(both_as_read > _INVERTED**2 * both_inverted and fit is not None
                and np.min(steps) > fit.translation_residual)


def _mirrored(poses: FloatArray) -> FloatArray:
    return se3.from_rotation_translation(poses[:, :3, :3], -poses[:, :3, 3])


def _refuse_mirrored(found: RigidFit, pairs: PosePairs, frames: str) -> None:
    """Raise MotionError if a mirrored world explains the misfit."""
    fit = best_fit(pairs, read_b=_mirrored, seconds=(found.lag_s,))
    if fit is not None and fit.one_body and fit.misfit < _LITTLE * found.misfit:
        raise MotionError(
            f'one of {frames} is in a left-handed frame: mirrored, {fit.rotation_share:.1%} of '
            f'the rotations and {fit.translation_share:.1%} of the translations differ, as read '
            f'{found.rotation_share:.1%} and {found.translation_share:.1%}. Export it '
            'right-handed')


def _reordered(shift: int) -> Read:
    def read(poses: FloatArray) -> FloatArray:
        q = np.roll(se3.rotation_to_quaternion(poses[:, :3, :3]), shift, axis=1)
        return se3.from_rotation_translation(se3.quaternion_to_rotation(q), poses[:, :3, 3])
    return read


def _conjugated(poses: FloatArray) -> FloatArray:
    return se3.from_rotation_translation(np.swapaxes(poses[:, :3, :3], 1, 2), poses[:, :3, 3])


# What the file holds, the option that reads it, and the conversion to the intended poses.
_ROTATIONS: tuple[tuple[str, str, Read], ...] = (
    ('quaternions in the order w, x, y, z', '--quaternion-order{} wxyz', _reordered(-1)),
    ('quaternions in the order x, y, z, w', '--quaternion-order{} xyzw', _reordered(1)),
    ('rotations of the world in the sensor beside positions of the sensor',
     'its rotations transposed (quaternions with x, y and z negated)', _conjugated),
)
_INVERSE = 'inverted poses (of the world in the sensor)', '--invert{}', se3.inverse


def _refuse_other_reading(
    found: RigidFit, pairs: PosePairs, a: Trajectory, b: Trajectory, config: CalibrationConfig,
) -> None:
    """Raise MotionError if the two are one body with another reading of the poses."""
    candidates = [item for item in _other_readings(found, pairs, a, b, config)
                  if item[0].one_body and item[0].misfit < _LITTLE * found.misfit]
    if not candidates:
        return
    best, what, option = min(candidates, key=lambda item: item[0].misfit)
    raise MotionError(
        f'{a.sensor_frame} and {b.sensor_frame} do not fit as read: {what}? Read so, their '
        f'translations differ by {best.translation_share:.1%} and their rotations by '
        f'{best.rotation_share:.1%}, instead of {found.translation_share:.0%} and '
        f'{found.rotation_share:.0%}. '
        f'Use {option}')


def _other_readings(
    found: RigidFit, pairs: PosePairs, a: Trajectory, b: Trajectory, config: CalibrationConfig,
) -> Iterator[tuple[RigidFit, str, str]]:
    """Yield the fit of other readings, a description, and the option for each.

    If the two are not one body as read, their clock offset is unknown too, and they are matched
    again if only one of them is read differently.
    """
    def fit_of(read_a: Read, read_b: Read) -> RigidFit | None:
        if found.one_body:
            return best_fit(pairs, read_a, read_b, (found.lag_s,))
        if read_a and read_b:
            return best_fit(pairs, read_a, read_b)
        anew_a, anew_b = (replace(trajectory, poses=read(trajectory.poses)) if read else trajectory
                          for trajectory, read in ((a, read_a), (b, read_b)))
        with suppress(AssociationError):
            return best_fit(match(anew_a, anew_b, config)[1])
        return None

    def of_one(what: str, option: str, read: Read) -> list[tuple[RigidFit, str, str]]:
        single = ((fit_of(read, None), a, '-a'), (fit_of(None, read), b, '-b'))
        return [(fit, f'does {sensor.sensor_frame} hold {what}', option.format(name))
                for fit, sensor, name in single if fit is not None]

    for what, option, read in _ROTATIONS:
        both = fit_of(read, read)
        if both is not None:
            yield both, f'do both hold {what}', option.format('')
        yield from of_one(what, option, read)
    inverted = of_one(*_INVERSE)
    told = [_moves_less_inverted(sensor) for sensor in (a, b)]
    if len(inverted) == 2 and told[0] != told[1]:
        yield inverted[told.index(True)]
    elif inverted:
        # The motion does not tell which of them.
        yield (min((item[0] for item in inverted), key=lambda fit: fit.misfit),
               'does one of them hold inverted poses (of the world in the sensor)',
               '--invert-a or --invert-b, whichever it is')


def _moves_less_inverted(trajectory: Trajectory) -> bool:
    step, inverted = least_steps(trajectory)
    return step > _INVERTED * inverted


def _refuse_two_bodies(
    pairs: PosePairs, a: Trajectory, b: Trajectory, config: CalibrationConfig,
) -> None:
    """Raise MotionError if independent errors do not explain the residuals."""
    found = list(fits(pairs))
    frames = f'{a.sensor_frame} and {b.sensor_frame}'
    if growth(found, 'rotation') > NOT_BY_NOISE or all(
            item.rotation_share >= _NOT_COMMON
            and item.translation_share >= ONE_BODY['translation'] for item in found):
        worst = max(found, key=lambda item: item.rotation_residual)
        raise MotionError(
            f'{frames} did not turn together: over {worst.lag_s:g} s they turn by '
            f'{rounded(np.rad2deg(worst.rotation))} deg, and differ by '
            f'{rounded(np.rad2deg(worst.rotation_residual))} deg. '
            f'{_advice_on_rotations(worst, pairs, a, b, config)}')
    factor = growth(found, 'translation')
    if factor > NOT_BY_NOISE and min(
            item.translation_share for item in found) > _NOT_COMMON:
        worst = max(found, key=lambda item: item.translation_residual)
        raise MotionError(
            f'{frames} turned together, but their positions do not fit one vehicle: over '
            f'{worst.lag_s:g} s they differ by {rounded(worst.translation_residual)} m, '
            f'{factor:.1f} times what noise explains. Check axes and units of both, or use '
            '--no-input-checks')


def _advice_on_rotations(
    found: RigidFit, pairs: PosePairs, a: Trajectory, b: Trajectory, config: CalibrationConfig,
) -> str:
    """Return what to do if the two did not rotate together.

    The clock offset may exceed the searched range: GPS time and UTC differ by 18 s.
    """
    if found.rotation < _STATIONARY:
        return 'Does the vehicle stand still? Record while it turns and moves'
    motions = select_motions(pairs, f'B{found.lag}')
    for sensor, poses in ((a, motions.A), (b, motions.B)):
        if np.median(se3.rotation_angle(poses[:, :3, :3])) < _STATIONARY:
            return (f'{sensor.sensor_frame} alone does not turn: did its SLAM stop, does it hold '
                    'the motions between its poses, or not ride on this vehicle?')
    # The rotations alone may agree.
    for finding in two_worlds(np.eye(4), pairs, (a.sensor_frame, b.sensor_frame)):
        return finding.text[0].upper() + finding.text[1:]
    advice = ('Are both of one drive of one vehicle? Check the topics or files, order and sign of '
              'angles, and the clocks (max_time_offset is the largest offset that is searched)')
    if config.time_offset_mode == 'fixed' or not 0 < config.max_time_offset < _FAR_OFFSET:
        return advice
    with suppress(AssociationError):
        clock, pairs = match(a, b, replace(config, max_time_offset=_FAR_OFFSET))
        fit = best_fit(pairs)
        steady = offset_steadiness(a, b, clock)
        if fit is not None and fit.one_body and steady is not None and (
                steady.scatter_s < _LARGEST_SCATTER_S):
            return (f'They do with {clock.offset_s:+.2f} s added to the stamps of '
                    f'{b.sensor_frame}. If their clocks are so far apart (GPS time and UTC: '
                    f'18 s), set time_offset to {clock.offset_s:.2f}, or raise max_time_offset')
    return advice


def _steady(
    a: Trajectory, b: Trajectory, clock: ClockCorrection, config: CalibrationConfig,
) -> tuple[Finding, ...]:
    """Check that a large clock offset is steady along the drive."""
    offset_s = clock.offset_s - config.time_offset
    # Smaller ones are usual.
    if abs(offset_s) <= 0.5:
        return ()
    steadiness = offset_steadiness(a, b, clock)
    if steadiness is None or not steadiness.unsteady or steadiness.scatter_s <= 0.010:
        return ()
    text = (
        f'the clock offset between {a.sensor_frame} and {b.sensor_frame}, {offset_s:+.2f} s, '
        f'varies by {1e3 * steadiness.scatter_s:.0f} ms: two vehicles on one road? If it is one, '
        'set time_offset, and time_offset_mode to fixed')
    if steadiness.scatter_s > _LARGEST_SCATTER_S:
        raise MotionError(text)
    return (Finding('clock-offset-unsteady', text, {
        'offset_s': offset_s, 'scatter_s': steadiness.scatter_s}),)
