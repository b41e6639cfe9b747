# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two trajectories and their systematic errors: the mean of the model.

All poses are relative to the first pose of each sensor, so the world frames do not matter. The
systematic errors are always in the model (``TERMS``):

====================  =====  ==========================================================
term                  prior  meaning
====================  =====  ==========================================================
scale                 1 %    log of metres of a per metre of b
drift x, y, z         0.2 %  true minus reported position of b, per metre, along its axes
latency               5 ms   delay of the position of b relative to its orientation
clock offset          5 ms   added to the stamps of b
====================  =====  ==========================================================

The priors are Cauchy distributions with that half width: typical for good sensors, with tails that
allow a wheel odometry of 5 %. Sources: scale and drift from the KITTI odometry tables (A. Geiger,
P. Lenz, R. Urtasun, CVPR 2012, doi:10.1109/CVPR.2012.6248074: 0.2 to 1 %, mostly along the path);
latencies of loosely coupled filters and of stamps at reception, 5 to 100 ms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import longest_step_ns
from trajectory_calibration.geometry.se3 import FloatArray, from_rotation_translation, skew
from trajectory_calibration.solvers.drift_aware.algebra import (
    apply,
    exp,
    log,
    ROTATION,
    TRANSLATION,
    transposed,
)

# Parameters: a twist of X in the axes of b, then the terms.
PARAMETERS = 12
SCALE, DRIFT, LATENCY, OFFSET = 6, slice(7, 10), 10, 11
TERMS = {'scale': slice(6, 7), 'systematic_drift': DRIFT, 'time_offset': slice(11, 12)}
HALF_WIDTH = np.array([0.01, 0.002, 0.002, 0.002, 0.005, 0.005])


@dataclass(frozen=True, eq=False)
class State:
    """The parameters: ``T_a_b`` (4, 4), ``terms`` (6,) in the order of the columns."""

    T_a_b: FloatArray
    terms: FloatArray

    def moved(self, step: FloatArray) -> State:
        """Return the state after a (12,) step."""
        R, t = self.T_a_b[:3, :3], self.T_a_b[:3, 3]
        T_a_b = from_rotation_translation(
            R @ exp(step[None, ROTATION])[0], t + R @ step[TRANSLATION])
        return State(T_a_b, self.terms + step[6:])


@dataclass(frozen=True, eq=False)
class Drive:
    """The poses of both sensors at common times.

    Attributes
    ----------
    times : (N,) seconds from the first.
    R_a, p_a, R_b, p_b : (N, 3, 3) rotations and (N, 3) positions relative to the first, in the
        world of each sensor.
    step_b : (N - 1, 3) translation of b in each step, in its own axes before the step.
    axes_b : (N - 1, 3, 3) mean rotation matrix of b during each step.
    velocity_b, acceleration_b : (N, 3) of b in its world, m/s and m/s^2; zero at gaps.
    twist_a : (N, 6) of a in its own axes, m/s and rad/s; zero at gaps.
    gap : (N - 1,) bool, whether a step is a gap.

    """

    times: FloatArray
    R_a: FloatArray
    p_a: FloatArray
    R_b: FloatArray
    p_b: FloatArray
    step_b: FloatArray
    axes_b: FloatArray
    velocity_b: FloatArray
    acceleration_b: FloatArray
    twist_a: FloatArray
    gap: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def step_s(self) -> float:
        """Return the median time between two poses, seconds."""
        return float(np.median(np.diff(self.times)))

    @classmethod
    def of(cls, pairs: PosePairs, every: int = 1) -> Drive:
        """Return the drive of every k-th pose pair, k = ``every``."""
        starts = np.arange(0, len(pairs), every)
        axes_b = np.add.reduceat(pairs.poses_b[:, :3, :3], starts)[:-1] / every
        pairs = pairs.thinned(every)
        times = (pairs.stamps_ns - pairs.stamps_ns[0]) * 1e-9
        R_a, R_b = pairs.poses_a[:, :3, :3], pairs.poses_b[:, :3, :3]
        p_a = pairs.poses_a[:, :3, 3] - pairs.poses_a[0, :3, 3]
        p_b = pairs.poses_b[:, :3, 3] - pairs.poses_b[0, :3, 3]
        gap = np.diff(pairs.stamps_ns) > longest_step_ns(pairs.stamps_ns)
        before = np.maximum(np.arange(len(times)) - 1, 0)
        after = np.minimum(np.arange(len(times)) + 1, len(times) - 1)
        known = ~(np.r_[False, gap] | np.r_[gap, False])
        rate = (known / (times[after] - times[before]))[:, None]
        spin = log(transposed(R_a[before]) @ R_a[after])
        return cls(
            times, R_a, p_a, R_b, p_b,
            step_b=apply(transposed(R_b[:-1]), np.diff(p_b, axis=0)),
            axes_b=axes_b,
            velocity_b=rate * (p_b[after] - p_b[before]),
            acceleration_b=_accelerations(times, p_b, gap),
            twist_a=rate * np.c_[apply(transposed(R_a), p_a[after] - p_a[before]), spin],
            gap=gap)

    def scaled(self, scale: float) -> Drive:
        """Return the drive with the lengths of b multiplied."""
        return replace(self, p_b=scale * self.p_b, step_b=scale * self.step_b,
                       velocity_b=scale * self.velocity_b,
                       acceleration_b=scale * self.acceleration_b)


def _accelerations(
    times: FloatArray, positions: FloatArray, gap: NDArray[np.bool_],
) -> FloatArray:
    """Return (N, 3) accelerations, zero at the ends and at gaps."""
    # Over 0.2 s before and after: differences of closer poses are noise.
    k = int(np.ceil(0.2 / np.median(np.diff(times))))
    result = np.zeros_like(positions)
    if len(times) > 2 * k:
        gaps = np.concatenate([[0], np.cumsum(gap)])
        velocity = (positions[k:] - positions[:-k]) / (times[k:] - times[:-k])[:, None]
        rate = 2 * (gaps[2 * k:] == gaps[:-2 * k]) / (times[2 * k:] - times[:-2 * k])
        result[k:-k] = rate[:, None] * (velocity[k:] - velocity[:-k])
    return result


@dataclass(frozen=True, eq=False)
class Corrected:
    """Both trajectories, corrected by a state.

    Attributes
    ----------
    R_ax, p_ax : (N, 3, 3), (N, 3) pose of b in the world of a, from the poses of a.
    by_offset : (N, 6) its derivative by the clock offset, a twist in the axes of b.
    p_b : (N, 3) position of b in its own world, corrected by the terms.
    by_terms : (N, 3, 5) its derivatives by scale, drift and latency.

    """

    R_ax: FloatArray
    p_ax: FloatArray
    by_offset: FloatArray
    p_b: FloatArray
    by_terms: FloatArray


def correct(drive: Drive, state: State) -> Corrected:
    """Return both trajectories corrected by a state."""
    R_x, t_x = state.T_a_b[:3, :3], state.T_a_b[:3, 3]
    scale, drift, latency, offset = (
        np.exp(state.terms[0]), state.terms[1:4], state.terms[4], state.terms[5])
    v, w = drive.twist_a[:, TRANSLATION], drive.twist_a[:, ROTATION]
    R_a, p_a = drive.R_a, drive.p_a
    if offset:
        p_a = p_a + offset * apply(R_a, v)
        R_a = R_a @ exp(offset * w)
    by_terms = np.empty((len(drive), 3, 5))
    by_terms[:, :, 0] = scale * drive.p_b
    by_terms[:, :, 1:4] = _drifted(drive, scale, drift)
    by_terms[:, :, 4] = drive.velocity_b + latency * drive.acceleration_b
    return Corrected(
        R_ax=R_a @ R_x,
        p_ax=R_a @ t_x + p_a,
        by_offset=twists_b(drive, state.T_a_b),
        p_b=by_terms[:, :, 0] + by_terms[:, :, 1:4] @ drift + latency * (
            drive.velocity_b + 0.5 * latency * drive.acceleration_b),
        by_terms=by_terms)


def twists_b(drive: Drive, T_a_b: FloatArray) -> FloatArray:
    """Return the (N, 6) twists of b in its own axes from those of a, m/s and rad/s."""
    R, t = T_a_b[:3, :3], T_a_b[:3, 3]
    result: FloatArray = drive.twist_a @ np.block([[R, np.zeros((3, 3))], [skew(t) @ R, R]])
    return result


def _drifted(drive: Drive, scale: float, drift: FloatArray) -> FloatArray:
    """Return (N, 3, 3): the integral of the rotation matrix of b over the true path length.

    A step of true length l is reported as ``m = truth - l drift``, so ``|m + l drift| = l``.
    """
    m = scale * drive.step_b
    along, factor = m @ drift, 1.0 - drift @ drift
    length = (np.sqrt(along**2 + factor * np.einsum('ni,ni->n', m, m)) + along) / factor
    result = np.zeros((len(drive), 3, 3))
    np.cumsum(length[:, None, None] * drive.axes_b, axis=0, out=result[1:])
    return result


def residuals(
    drive: Drive, at: Corrected, i: NDArray[np.intp], j: NDArray[np.intp],
) -> FloatArray:
    """Return the (M, 6) residuals of the motions from poses i to j: translation, rotation.

    The motion of b minus that of a carried to b. Translation in the axes of b at i, rotation in
    those of b at j.
    """
    back_a, back_b = transposed(at.R_ax[i]), transposed(drive.R_b[i])
    rotation = transposed(back_a @ at.R_ax[j]) @ (back_b @ drive.R_b[j])
    moved = apply(back_b, at.p_b[j] - at.p_b[i]) - apply(back_a, at.p_ax[j] - at.p_ax[i])
    return np.c_[moved, log(rotation)]


def prior_precision(terms: FloatArray, modes: Mapping[str, str]) -> FloatArray:
    """Return the (12,) curvatures of the majorants of the priors at the present terms.

    The Cauchy cost ``2 log(1 + x^2 / g^2)`` is below the parabola of curvature
    ``2 / (g^2 + x^2)`` that touches it at x, so iterating on parabolas descends. The curvature is
    zero for 'estimate' and infinite for 'fixed'.
    """
    # A very weak prior of the extrinsic, a kilometre and any angle: unobservable directions stay
    # finite and have a large covariance.
    of_extrinsic = np.repeat([1e-6, 1e-2], 3)
    precision = np.concatenate([of_extrinsic, 2.0 / (HALF_WIDTH**2 + terms**2)])
    for name, columns in TERMS.items():
        if modes[name] == 'estimate':
            precision[columns] = 0.0
        elif modes[name] == 'fixed':
            precision[columns] = np.inf
    return precision
