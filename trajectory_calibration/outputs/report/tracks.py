# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where a went, and where b says that a went: the two tracks of a result, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.covariance import most_likely
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.time_alignment.pairing import associate

# A step in which the tracks part by this many usual ones is a jump, also where no solver says so.
_JUMP = 12.0
# Jumps that are drawn, the largest.
MOST_JUMPS = 80
# The least standard deviation of a pose, metres and radians: rounding of files.
_LEAST_NOISE = 1e-10
# Poses farther apart than this many usual steps tell no velocity.
_NEAR = 3.0

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Tracks:
    """The poses of a, and those of a as b reports them through the extrinsic.

    ``pairs`` are poses of both at common times, clock, scale and drift of b corrected;
    ``poses_c``, (K, 4, 4), sensor a as b reports it, moved as a whole onto the track of a. (K,):
    ``seconds`` from the first pair, ``path_m`` driven by a until then, ``distance_m`` and
    ``angle_deg`` between the two. Indices of the poses after ``jumps``, (J,), and before
    ``gaps`` of either sensor, (G,); ``usable``, (K - 1,), are steps without a jump. ``noise``,
    (S, 3), has by time scale, seconds, the deviations of what the motions of both differ by, along
    and about an axis, metres and radians.
    """

    pairs: PosePairs
    poses_c: FloatArray
    seconds: FloatArray
    path_m: FloatArray
    distance_m: FloatArray
    angle_deg: FloatArray
    jumps: Indices
    usable: NDArray[np.bool_]
    gaps: Indices
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.seconds)

    def largest_jumps(self) -> Indices:
        """Return the indices of ``MOST_JUMPS``, those in which the tracks part most."""
        apart = np.diff(self.pairs.poses_a[:, :3, 3], axis=0) - np.diff(
            self.poses_c[:, :3, 3], axis=0)
        size = np.linalg.norm(apart[self.jumps - 1], axis=1)
        return np.sort(self.jumps[np.argsort(-size, kind='stable')[:MOST_JUMPS]])

    def motions(
        self, i: Indices, j: Indices,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the (M, 4, 4) motions of both from poses i to j, and (M, 6) ``log(A^-1 C)``."""
        return _motions(self.pairs.poses_a, self.poses_c, i, j)

    def covariance(
        self, T_a_b: FloatArray, A: FloatArray, i: Indices, j: Indices,
    ) -> FloatArray:
        """Return (M, 6, 6), what noise does to ``log(A^-1 C)`` of the motions A from i to j.

        The noise of the first pose reaches the translation through the length of the motion, that
        of the way through a third of its square.
        """
        X = se3.adjoint(T_a_b)

        def of_both(variances: FloatArray) -> FloatArray:
            """Return what half of (..., 2) variances, of each sensor in its own axes, make."""
            own = 0.5 * np.repeat(variances, 3, axis=-1)[..., None] * np.eye(6)
            return own + X @ own @ X.T

        seconds = self.seconds[j] - self.seconds[i]
        both = np.stack([np.interp(seconds, self.noise[:, 0], variance)
                         for variance in self.noise[:, 1:].T**2], axis=-1)
        pose = 0.5 * self.noise[0, 1:]**2
        white, drift = of_both(pose), of_both(np.maximum(both - 2 * pose, 0.0))
        near = A.copy()
        near[:, :3, 3] /= np.sqrt(3.0)
        far, near = se3.adjoint(se3.inverse(A)), se3.adjoint(se3.inverse(near))
        return (white + far @ white @ np.swapaxes(far, 1, 2)
                + near @ drift @ np.swapaxes(near, 1, 2))


def corrected_b(result: CalibrationResult, b: Trajectory) -> Trajectory:
    """Return b in the clock and the unit of a, as the result has them."""
    b = b.retimed(result.clock_drift, result.clock_drift_from_ns).scaled(result.scale)
    return replace(b, stamps_ns=b.stamps_ns + round(result.time_offset_s * 1e9))


def compare_tracks(result: CalibrationResult, a: Trajectory, b: Trajectory) -> Tracks:
    """Carry ``corrected_b`` over to a; raises AssociationError where they do not meet."""
    pairs = associate(a, b, result.config)
    diagnosis = result.diagnosis or {}
    poses_b = _without_drift(pairs.poses_b, diagnosis.get('systematic_drift', (0, 0, 0)))
    poses_b = _in_time(poses_b, pairs.stamps_ns, diagnosis.get('latency_s', 0.0))
    pairs = replace(pairs, poses_b=poses_b)
    poses_c = pairs.poses_b @ se3.inverse(result.T_a_b)
    poses_c = se3.registration(pairs.poses_a, poses_c) @ poses_c
    jumps = _jumps(diagnosis.get('jumps', ()), pairs, poses_c)
    usable = np.ones(len(pairs) - 1, dtype=bool)
    usable[jumps - 1] = False
    p_a, p_c = pairs.poses_a[:, :3, 3], poses_c[:, :3, 3]
    apart = np.swapaxes(pairs.poses_a[:, :3, :3], 1, 2) @ poses_c[:, :3, :3]
    return Tracks(
        pairs, poses_c,
        seconds=(pairs.stamps_ns - pairs.stamps_ns[0]) * 1e-9,
        path_m=np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_a, axis=0), axis=1))]),
        distance_m=np.linalg.norm(p_a - p_c, axis=1),
        angle_deg=np.rad2deg(se3.rotation_angle(apart)),
        jumps=jumps, usable=usable, gaps=_gaps(pairs, a, b),
        noise=_noise(result, pairs, poses_c))


def _noise(result: CalibrationResult, pairs: PosePairs, poses_c: FloatArray) -> FloatArray:
    """Return the (S, 3) noise of ``Tracks``, as the solver that identifies it has it."""
    apart = (result.diagnosis or {}).get('apart')
    if apart is None:
        with suppress(MotionError, SolverError):
            known = most_likely(pairs, result.config).diagnosis
            apart = None if known is None else known.apart
    if apart is None:
        # Too few poses for a model: what the steps differ by.
        steps = _steps_apart(pairs, poses_c).reshape(-1, 2, 3)
        apart = [[0.0, *np.sqrt(np.mean(steps**2, axis=(0, 2)))]]
    return np.maximum(apart, [0.0, _LEAST_NOISE, _LEAST_NOISE])


def _motions(
    poses_a: FloatArray, poses_c: FloatArray, i: Indices, j: Indices,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    A, C = (se3.inverse(poses[i]) @ poses[j] for poses in (poses_a, poses_c))
    return A, C, se3.log_se3(se3.inverse(A) @ C)


def _steps_apart(pairs: PosePairs, poses_c: FloatArray) -> FloatArray:
    """Return (K - 1, 6), by how much the steps of both differ."""
    i = np.arange(len(pairs) - 1)
    return _motions(pairs.poses_a, poses_c, i, i + 1)[2]


def _gaps(pairs: PosePairs, *trajectories: Trajectory) -> Indices:
    """Return the indices of the pairs after which one of the sensors has a gap."""
    middles = np.concatenate([
        (item.stamps_ns[:-1] + np.diff(item.stamps_ns) // 2)[item.gaps] for item in trajectories])
    before = np.unique(np.searchsorted(pairs.stamps_ns, middles) - 1)
    return before[(before >= 0) & (before < len(pairs) - 1)]


def _without_drift(poses_b: FloatArray, drift: Sequence[float]) -> FloatArray:
    """Take a constant drift per metre, that was identified, out of the positions of b."""
    if not any(drift):
        return poses_b
    steps = np.diff(poses_b[:, :3, 3], axis=0)
    length = np.linalg.norm(steps, axis=1)
    steps -= length[:, None] * (poses_b[:-1, :3, :3] @ drift)
    corrected = poses_b.copy()
    corrected[1:, :3, 3] = poses_b[0, :3, 3] + np.cumsum(steps, axis=0)
    return corrected


def _in_time(poses_b: FloatArray, stamps_ns: NDArray[np.int64], latency_s: float) -> FloatArray:
    """Move the positions of b to where they belong, where they are older than the attitude."""
    if not latency_s:
        return poses_b
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    # As far as neighbours tell a velocity: a jump in a gap is none.
    near = np.diff(seconds) <= _NEAR * np.median(np.diff(seconds))
    known = np.concatenate([[True], near]) & np.concatenate([near, [True]])
    moved = poses_b.copy()
    moved[:, :3, 3] += latency_s * known[:, None] * np.gradient(poses_b[:, :3, 3], seconds, axis=0)
    return moved


def _jumps(
    named: Sequence[dict[str, Any]], pairs: PosePairs, poses_c: FloatArray,
) -> Indices:
    """Return the indices of the poses after a jump: named by the solver, or large."""
    nearest = [np.abs(pairs.stamps_ns[1:] - jump['stamp_ns']).argmin() for jump in named]
    size = np.linalg.norm(_steps_apart(pairs, poses_c).reshape(-1, 2, 3), axis=2)
    large = (size > np.maximum(_JUMP * np.median(size, axis=0), 1e-9)).any(axis=1)
    return 1 + np.union1d(np.array(nearest, dtype=np.intp), np.flatnonzero(large))
