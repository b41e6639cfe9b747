# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The track of a, and the track of a from b with the extrinsic."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
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

# A residual of a step above this many medians is a jump, even if the solver found none.
_JUMP = 12.0
# Most jumps that are drawn; the largest are kept.
MOST_JUMPS = 80
# Smallest standard deviation of a pose, metres and radians: rounding of files.
_LEAST_NOISE = 1e-10
# No velocity is computed over a time step above this many medians.
_NEAR = 3.0

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Tracks:
    """The poses of a from its own trajectory, and from that of b with the extrinsic.

    ``pairs`` are K poses of both at common times, with clock, scale and drift of b corrected;
    ``poses_c`` (K, 4, 4) are the poses of a from b, aligned to the track of a. (K,) arrays:
    ``seconds`` from the first pair, path length of a ``path_m``, ``distance_m`` and ``angle_deg``
    between the tracks. ``jumps`` (J,) are indices of poses after a jump, ``gaps`` (G,) of poses
    before a gap of either sensor; ``usable`` (K - 1,) are steps without a jump. ``noise`` (S, 3)
    has time scales, seconds, and standard deviations of ``log(A^-1 C)`` per axis, metres, radians.
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

    @cached_property
    def largest_jumps(self) -> Indices:
        """Return the indices of the ``MOST_JUMPS`` largest jumps, in the order of time."""
        differences = np.diff(self.pairs.poses_a[:, :3, 3], axis=0) - np.diff(
            self.poses_c[:, :3, 3], axis=0)
        size = np.linalg.norm(differences[self.jumps - 1], axis=1)
        return np.sort(self.jumps[np.argsort(-size, kind='stable')[:MOST_JUMPS]])

    def motions(
        self, i: Indices, j: Indices,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the (M, 4, 4) motions of both from poses i to j, and (M, 6) ``log(A^-1 C)``."""
        return _motions(self.pairs.poses_a, self.poses_c, i, j)

    def covariance(
        self, T_a_b: FloatArray, A: FloatArray, i: Indices, j: Indices,
    ) -> FloatArray:
        """Return (M, 6, 6) covariances of ``log(A^-1 C)`` from noise, for motions A from i to j.

        Rotation noise of the first pose acts on the translation with the length of the motion as
        lever arm; a random walk during the motion has a third of its square.
        """
        X = se3.adjoint(T_a_b)

        def of_both(variances: FloatArray) -> FloatArray:
            """Return (..., 6, 6) from (..., 2) variances, half of which is of each sensor."""
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
    """Return b in the clock and the unit of a, corrected by the result."""
    b = b.retimed(result.clock_drift, result.clock_drift_from_ns).scaled(result.scale)
    return replace(b, stamps_ns=b.stamps_ns + round(result.time_offset_s * 1e9))


def compare_tracks(result: CalibrationResult, a: Trajectory, b: Trajectory) -> Tracks:
    """Return the tracks of a and ``corrected_b``.

    Raises AssociationError if they have no common time.
    """
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
    R_a_c = np.swapaxes(pairs.poses_a[:, :3, :3], 1, 2) @ poses_c[:, :3, :3]
    return Tracks(
        pairs, poses_c,
        seconds=(pairs.stamps_ns - pairs.stamps_ns[0]) * 1e-9,
        path_m=np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_a, axis=0), axis=1))]),
        distance_m=np.linalg.norm(p_a - p_c, axis=1),
        angle_deg=np.rad2deg(se3.rotation_angle(R_a_c)),
        jumps=jumps, usable=usable, gaps=_gaps(pairs, a, b),
        noise=_noise(result, pairs, poses_c))


def _noise(result: CalibrationResult, pairs: PosePairs, poses_c: FloatArray) -> FloatArray:
    """Return the (S, 3) noise of ``Tracks`` from the diagnosis of the most likely solver."""
    noise = (result.diagnosis or {}).get('apart')
    if noise is None:
        with suppress(MotionError, SolverError):
            known = most_likely(pairs, result.config).diagnosis
            noise = None if known is None else known.apart
    if noise is None:
        # Too few poses for a noise model: root mean square of the residuals of steps.
        steps = _step_residuals(pairs, poses_c).reshape(-1, 2, 3)
        noise = [[0.0, *np.sqrt(np.mean(steps**2, axis=(0, 2)))]]
    return np.maximum(noise, [0.0, _LEAST_NOISE, _LEAST_NOISE])


def _motions(
    poses_a: FloatArray, poses_c: FloatArray, i: Indices, j: Indices,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    A, C = (se3.inverse(poses[i]) @ poses[j] for poses in (poses_a, poses_c))
    return A, C, se3.log_se3(se3.inverse(A) @ C)


def _step_residuals(pairs: PosePairs, poses_c: FloatArray) -> FloatArray:
    """Return (K - 1, 6) residuals ``log(A^-1 C)`` of the steps from pose to pose."""
    i = np.arange(len(pairs) - 1)
    return _motions(pairs.poses_a, poses_c, i, i + 1)[2]


def _gaps(pairs: PosePairs, *trajectories: Trajectory) -> Indices:
    """Return indices of the pairs before a gap of either sensor."""
    middles = np.concatenate([
        (item.stamps_ns[:-1] + np.diff(item.stamps_ns) // 2)[item.gaps] for item in trajectories])
    before = np.unique(np.searchsorted(pairs.stamps_ns, middles) - 1)
    return before[(before >= 0) & (before < len(pairs) - 1)]


def _without_drift(poses_b: FloatArray, drift: Sequence[float]) -> FloatArray:
    """Remove the identified constant drift per metre from the positions of b."""
    if not any(drift):
        return poses_b
    steps = np.diff(poses_b[:, :3, 3], axis=0)
    length = np.linalg.norm(steps, axis=1)
    steps -= length[:, None] * (poses_b[:-1, :3, :3] @ drift)
    corrected = poses_b.copy()
    corrected[1:, :3, 3] = poses_b[0, :3, 3] + np.cumsum(steps, axis=0)
    return corrected


def _in_time(poses_b: FloatArray, stamps_ns: NDArray[np.int64], latency_s: float) -> FloatArray:
    """Correct positions of b that are older than the orientations by the latency."""
    if not latency_s:
        return poses_b
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    # A displacement over a gap is no velocity.
    near = np.diff(seconds) <= _NEAR * np.median(np.diff(seconds))
    known = np.concatenate([[True], near]) & np.concatenate([near, [True]])
    moved = poses_b.copy()
    moved[:, :3, 3] += latency_s * known[:, None] * np.gradient(poses_b[:, :3, 3], seconds, axis=0)
    return moved


def _jumps(
    named: Sequence[dict[str, Any]], pairs: PosePairs, poses_c: FloatArray,
) -> Indices:
    """Return indices of the poses after a jump: found by the solver, or large."""
    nearest = [np.abs(pairs.stamps_ns[1:] - jump['stamp_ns']).argmin() for jump in named]
    size = np.linalg.norm(_step_residuals(pairs, poses_c).reshape(-1, 2, 3), axis=2)
    large = (size > np.maximum(_JUMP * np.median(size, axis=0), 1e-9)).any(axis=1)
    return 1 + np.union1d(np.array(nearest, dtype=np.intp), np.flatnonzero(large))
