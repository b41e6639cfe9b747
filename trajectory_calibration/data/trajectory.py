# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory: the poses of one sensor in the world of its SLAM, with stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.data.findings import Finding, texts
from trajectory_calibration.errors import counted, TrajectoryError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Of a trajectory that nobody named.
WORLD_FRAME, SENSOR_FRAME = 'map', 'sensor'

# Deviation of a quaternion's norm, or of a rotation matrix's columns, from unit length. Up to the
# first limit it is rounding to six digits and is corrected silently; up to the second it is
# corrected with a finding; beyond, the numbers are not a rotation.
ROUNDING_TOLERANCE = 1e-5
ROTATION_TOLERANCE = 1e-2

# Largest position along an axis, metres: beyond every map on Earth, and small enough that squares
# and differences keep their digits.
MAX_POSITION = 1e9

# No two clocks differ by more than this (s/s): daemons that steer a clock stop at 5e-4.
LARGEST_DRIFT = 1e-3


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The poses of one sensor in the world of its own SLAM; validated once, then read-only.

    Attributes
    ----------
    stamps_ns : (N,) int64
        Time of each pose, nanoseconds, strictly increasing.
    poses : (N, 4, 4) float64
        ``T_world_sensor`` at each stamp, metres.
    world_frame, sensor_frame : str
        Names of the two frames.
    findings : tuple of Finding
        Repairs of the input: samples reordered, duplicates dropped, rotations normalised. Passed
        on to the result.

    Raises
    ------
    TrajectoryError
        Wrong shapes, fewer than two poses, numbers that are not finite or beyond
        ``MAX_POSITION``, matrices that are not rigid motions.

    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    world_frame: str = WORLD_FRAME
    sensor_frame: str = SENSOR_FRAME
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        stamps_ns, order, notes = _checked_stamps(self.stamps_ns)
        poses = _real_numbers(self.poses, 'poses', 'one (4, 4) matrix per stamp')
        if poses.shape != (len(stamps_ns), 4, 4):
            raise TrajectoryError(
                f'poses have the shape {poses.shape}, needed ({len(stamps_ns)}, 4, 4) to match '
                f'{len(stamps_ns)} stamps; pass one homogeneous matrix per stamp')
        notes += _repair_rotations(poses)
        self._settle(stamps_ns[order], poses[order], notes)

    def _settle(
        self, stamps_ns: NDArray[np.int64], poses: FloatArray, notes: list[str],
    ) -> None:
        """Store checked stamps and poses that are sorted by time."""
        if len(stamps_ns) < 2:
            raise TrajectoryError(
                f'{self.sensor_frame}: {len(stamps_ns)} pose with a stamp of its own, needed at '
                'least 2; record while the sensor moves')
        stamps_ns.setflags(write=False)
        poses.setflags(write=False)
        # Not by assignment, because the class is frozen.
        self.__dict__.update(stamps_ns=stamps_ns, poses=poses, findings=(*self.findings, *(
            Finding('input-repaired', f'{self.sensor_frame}: {note}') for note in notes)))

    @classmethod
    def from_quaternions(
        cls,
        stamps_ns: ArrayLike,
        positions: ArrayLike,
        quaternions_xyzw: ArrayLike,
        world_frame: str = WORLD_FRAME,
        sensor_frame: str = SENSOR_FRAME,
        findings: tuple[Finding, ...] = (),
    ) -> Trajectory:
        """Build a trajectory from (N,) stamps, (N, 3) metres, (N, 4) quaternions x, y, z, w.

        Raises TrajectoryError as the class, and for a norm that is off 1 by more than 0.01.
        """
        p = _real_numbers(positions, 'positions', 'one row x, y, z per stamp')
        q = _real_numbers(quaternions_xyzw, 'quaternions', 'one row x, y, z, w per stamp')
        if p.ndim != 2 or p.shape[1] != 3 or q.shape != (len(p), 4):
            raise TrajectoryError(
                f'positions have the shape {p.shape} and quaternions {q.shape}, needed (N, 3) '
                'and (N, 4)')
        _require_finite(np.concatenate([p, q], axis=1))
        with np.errstate(over='ignore'):
            norm = np.linalg.norm(q, axis=1)
        repaired = _judge_deviation(np.abs(norm - 1), 'the norm of the quaternion', norm)
        _require_near(p)
        stamps, order, notes = _checked_stamps(stamps_ns)
        if len(stamps) != len(p):
            raise TrajectoryError(f'{len(stamps)} stamps and {len(p)} positions; needed one stamp '
                                  'per position')
        # Unit quaternions give rotations: no further check is needed.
        poses = se3.from_rotation_translation(se3.quaternion_to_rotation(q / norm[:, None]), p)
        result = object.__new__(cls)
        result.__dict__.update(
            world_frame=world_frame, sensor_frame=sensor_frame, findings=findings)
        result._settle(stamps[order], poses[order], repaired + notes)
        return result

    @classmethod
    def from_arrays(
        cls,
        seconds: ArrayLike,
        positions: ArrayLike,
        quaternions_xyzw: ArrayLike,
        *,
        world_frame: str = WORLD_FRAME,
        sensor_frame: str = SENSOR_FRAME,
    ) -> Trajectory:
        """Build a trajectory from arrays, as in a notebook.

        Raises TrajectoryError as the class, and for times beyond the year 2262.

        Parameters
        ----------
        seconds : (N,)
            Times, seconds. Since 1970, float64 resolves 0.2 us.
        positions : (N, 3)
            x, y, z of the sensor in its world, metres.
        quaternions_xyzw : (N, 4)
            x, y, z, w of its orientation.
        world_frame, sensor_frame : str
            Names of the frames.

        """
        time = _real_numbers(seconds, 'seconds', 'one per pose')
        # The range of int64 nanoseconds; NaN fails, too.
        if not (np.abs(time) < 9.2e9).all():
            raise TrajectoryError(
                'seconds are not finite or beyond the year 2262; are they in another unit?')
        return cls.from_quaternions(np.rint(time * 1e9).astype(np.int64), positions,
                                    quaternions_xyzw, world_frame, sensor_frame)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the sentences of the findings."""
        return texts(self.findings)

    def __repr__(self) -> str:
        return (f'<Trajectory of {self.sensor_frame} in {self.world_frame}: '
                f'{counted(len(self), "pose")} over {self.duration_s:.1f} s>')

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def scaled(self, scale: float) -> Trajectory:
        """Return the trajectory with its positions multiplied; itself for a scale of one."""
        return self if scale == 1.0 else replace(self, poses=se3.scaled(self.poses, scale))

    def retimed(self, drift: float, from_ns: int) -> Trajectory:
        """Return the trajectory with the stamps of a clock that runs faster by ``drift`` (s/s).

        At ``from_ns`` the clocks agree. Itself for a drift of zero.
        """
        if drift == 0.0:
            return self
        shift = np.rint(drift * (self.stamps_ns - from_ns).astype(np.float64)).astype(np.int64)
        return replace(self, stamps_ns=self.stamps_ns + shift)

    @cached_property
    def usual_step_ns(self) -> float:
        """Median time between two poses, nanoseconds."""
        return float(np.median(np.diff(self.stamps_ns)))

    def poses_in(self, time_ns: float) -> int:
        """Return the number of steps in a time, at least one."""
        return max(1, round(time_ns / self.usual_step_ns))

    @cached_property
    def longest_step_ns(self) -> float:
        """Return the length, nanoseconds, beyond which a step is a gap."""
        return longest_step_ns(self.stamps_ns)

    @cached_property
    def gaps(self) -> NDArray[np.bool_]:
        """(N - 1,), whether the step from each pose to the next is a gap."""
        return np.diff(self.stamps_ns) > self.longest_step_ns

    @cached_property
    def turns(self) -> FloatArray:
        """(N - 1, 3) rotation vectors from each pose to the next, in the axes of the sensor."""
        R = self.rotations
        return se3.log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:])

    @property
    def positions(self) -> FloatArray:
        """(N, 3) positions of the sensor in its world, metres."""
        return self.poses[:, :3, 3]

    @property
    def rotations(self) -> FloatArray:
        """(N, 3, 3) orientations of the sensor in its world."""
        return self.poses[:, :3, :3]

    @property
    def duration_s(self) -> float:
        """Seconds from the first pose to the last."""
        return (int(self.stamps_ns[-1]) - int(self.stamps_ns[0])) * 1e-9


def longest_step_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Return the length, nanoseconds, beyond which a step is a gap: five median steps and 0.5 s.

    The motion in a gap is unknown, and a SLAM may have lost its track there.
    """
    return max(5 * float(np.median(np.diff(stamps_ns))), 500_000_000)


def recording_of(*trajectories: Trajectory) -> str:
    """Return a checksum of all stamps and poses; the frame names do not matter."""
    return ''.join(f'{crc32(np.ascontiguousarray(values).data):08x}' for trajectory in trajectories
                   for values in (trajectory.stamps_ns, trajectory.poses))


def recordings_in(recording: str) -> tuple[str, ...]:
    """Split the ``recording_of`` several trajectories into those of each."""
    return tuple(recording[k:k + 16] for k in range(0, len(recording), 16))


def pose_faults(
    poses: FloatArray,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return three masks of faulty (N, 7) poses (x, y, z, qx, qy, qz, qw).

    Not finite; otherwise no unit quaternion; otherwise beyond ``MAX_POSITION``.
    """
    finite = np.asarray(np.isfinite(poses).all(axis=1))
    # The square of a huge number is infinite, which is no unit length.
    with np.errstate(over='ignore'):
        norms = np.linalg.norm(np.where(finite[:, None], poses[:, 3:], 0.0), axis=1)
    unit = np.abs(norms - 1.0) <= ROTATION_TOLERANCE
    near = (np.abs(poses[:, :3]) <= MAX_POSITION).all(axis=1)
    return ~finite, finite & ~unit, finite & unit & ~near


def _real_numbers(values: ArrayLike, what: str, needed: str) -> FloatArray:
    """Return a new float64 array; raise TrajectoryError for rows of unequal length or words."""
    try:
        array = np.asarray(values)
        if np.iscomplexobj(array):
            raise TrajectoryError(f'{what} are complex, needed real numbers: {needed}')
        return np.array(array, dtype=np.float64)
    except (OverflowError, TypeError, ValueError) as error:
        if isinstance(error, TrajectoryError):
            raise
        raise TrajectoryError(
            f'{what} are no array of numbers ({error}), needed {needed}') from error


def longest_run(stamps_ns: NDArray[np.int64]) -> slice:
    """Return the longest part of (N,) stamps if there are several recordings that overlap in time.

    Two recordings in one file, or a restarted simulation: sorted by time, the poses of both would
    alternate. The whole range if rows are only out of order: by less than a second, or in parts of
    fewer than 10 poses.
    """
    anew_ns = 1_000_000_000
    edges = np.flatnonzero(np.diff(stamps_ns) < -anew_ns) + 1
    starts, ends = np.append(0, edges), np.append(edges, len(stamps_ns))
    if not len(edges) or (ends - starts).min() < 10:
        return slice(None)
    order = np.argsort(stamps_ns[starts], kind='stable')
    overlap = stamps_ns[ends - 1][order][:-1] - stamps_ns[starts][order][1:]
    if overlap.max() < anew_ns:
        return slice(None)
    longest = int(np.argmax(ends - starts))
    return slice(int(starts[longest]), int(ends[longest]))


def _checked_stamps(
    stamps: ArrayLike,
) -> tuple[NDArray[np.int64], NDArray[np.intp] | slice, list[str]]:
    """Return the stamps, the order that sorts them without duplicates, and notes."""
    try:
        array = np.asarray(stamps)
    except ValueError as error:
        raise TrajectoryError(
            f'stamps are no array of numbers ({error}), needed one integer per pose') from error
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        raise TrajectoryError(
            f'stamps are {array.dtype} of shape {array.shape}, needed one-dimensional integer '
            'nanoseconds; multiply seconds by 1e9 and round')
    if array.dtype == np.uint64 and array.max(initial=0) > np.iinfo(np.int64).max:
        raise TrajectoryError(
            f'stamp {int(np.argmax(array))} is {array.max()} ns, needed less than 2^63, the year '
            '2262; is the unit nanoseconds?')
    stamps_ns = np.array(array, dtype=np.int64)
    if len(stamps_ns):
        span = int(stamps_ns.max()) - int(stamps_ns.min())
        if span > np.iinfo(np.int64).max:
            raise TrajectoryError(
                f'the stamps reach over {span / (365.25 * 86400e9):.0f} years, needed less than '
                '292; remove the wrong stamps, or is the unit nanoseconds?')
    if np.all(stamps_ns[1:] > stamps_ns[:-1]):
        return stamps_ns, slice(None), []
    run, notes = longest_run(stamps_ns), []
    part = stamps_ns[run]
    if len(part) < len(stamps_ns):
        notes.append(f'dropped {counted(len(stamps_ns) - len(part), "pose")}: time restarted '
                     '(two recordings in one?); the longest part was kept')
    backwards = int(np.count_nonzero(part[1:] < part[:-1]))
    if backwards:
        notes.append('sorted the poses by stamp: time ran backwards in '
                     f'{counted(backwards, "place")}')
    order = np.argsort(part, kind='stable')
    first = np.append(True, np.diff(part[order]) > 0)
    duplicates = int(np.count_nonzero(~first))
    if duplicates:
        notes.append(f'dropped {counted(duplicates, "pose")} with the stamp of another')
    return stamps_ns, np.arange(len(stamps_ns))[run][order[first]], notes


def _repair_rotations(poses: FloatArray) -> list[str]:
    """Make the rotations of (N, 4, 4) poses orthonormal in place; return notes, or raise."""
    _require_finite(poses.reshape(len(poses), 16))
    _require_near(poses[:, :3, 3])
    if not (np.abs(poses[:, 3] - [0, 0, 0, 1]) < ROUNDING_TOLERANCE).all():
        raise TrajectoryError('the last row of a pose is not 0 0 0 1; needed homogeneous matrices')
    R = poses[:, :3, :3]
    # Squares of large numbers overflow; such poses are refused below.
    with np.errstate(over='ignore', invalid='ignore'):
        deviation = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        right_handed = np.sum(np.cross(R[:, 0], R[:, 1]) * R[:, 2], axis=1) > 0
        deviation = np.where(right_handed, deviation, np.inf)
    notes = _judge_deviation(deviation, 'the deviation from a rotation', deviation)
    if deviation.max(initial=0.0) > 1e-14:
        poses[:, :3, :3] = se3.nearest_rotation(R)
    poses[:, 3] = [0, 0, 0, 1]
    return notes


def _require_near(positions: FloatArray) -> None:
    far = np.abs(positions).max(axis=1, initial=0.0)
    if far.max(initial=0.0) > MAX_POSITION:
        k = int(np.argmax(far > MAX_POSITION))
        raise TrajectoryError(
            f'pose {k} lies {far[k]:.3g} m from the origin along an axis, needed at most '
            f'{MAX_POSITION:.0e} m; remove what the SLAM wrote while it was lost, or is the unit '
            'metres?')


def _require_finite(rows: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise TrajectoryError(
            f'pose {bad[0]} is not finite ({len(bad)} of {len(rows)} are not); remove what the '
            'SLAM wrote while it was lost')


def _judge_deviation(deviation: FloatArray, what: str, shown: FloatArray) -> list[str]:
    """Return a note beyond rounding; raise beyond the tolerance."""
    # NaN fails, too.
    if not (deviation <= ROTATION_TOLERANCE).all():
        k = int(np.argmax(deviation))
        raise TrajectoryError(
            f'pose {k}: {what} is {shown[k]:.6g}, off by more than {ROTATION_TOLERANCE}; is the '
            'order x, y, z, w (not w first), and are the columns the right ones?')
    off = deviation[deviation > ROUNDING_TOLERANCE]
    return [f'normalised {counted(len(off), "rotation")} (off by up to {off.max():.2g})'
            ] if len(off) else []
