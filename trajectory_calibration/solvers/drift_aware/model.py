"""The drift-aware model: what two trajectories say about each other, pose by pose.

The unknowns are the extrinsic ``X = T_a_b``, the pose ``Y_k`` of sensor b in the world of a at
every instant, and up to three global terms. Two residuals tie them to the data:

* observation, of pose k: ``r_k`` between ``A_k X`` and ``Y_k``, the white noise of both sensors;
* walk, of the step from k to k + 1: ``q_k`` between ``Y_k dB_k`` and ``Y_{k+1}``, the drift and
  the jumps of both, with ``dB_k = B_k^-1 B_{k+1}``.

Both are (6,): the difference of the positions in the axes of the predicted pose (metres), then
the rotation vector from the predicted to the found rotation (radians). Poses are perturbed on
the right in the same way: ``t + R rho``, ``R exp(phi)``.

The global terms correct the translation ``p`` of a step of b, ``s p - l d``, and the time
(``corrected_steps`` has the steps of a thinned chain as well):

* ``scale`` s: metres of a per metre of b;
* ``systematic_drift`` d: (3,) metres per metre moved, along the axes of b; ``l`` is the length
  of the corrected step;
* ``time_offset`` tau: seconds, sensor a is evaluated at ``t + tau``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.pool import Pool

IndexArray = NDArray[np.intp]

# Columns of the global parameters: the extrinsic, then the terms that may be estimated.
EXTRINSIC = slice(0, 6)
TERM_COLUMNS = {
    'scale': slice(6, 7),
    'systematic_drift': slice(7, 10),
    'time_offset': slice(10, 11),
}
PARAMETERS = 11

# A step has at least this share of the mean length, so that a sensor at rest may still drift.
_REST_SHARE = 0.1
# Steps over which the speed and the rate of turn of a step are averaged.
_SPEED_WINDOW, _TURN_WINDOW = 11, 5


def columns_of(terms: Sequence[str]) -> IndexArray:
    """Return the indices of the global parameters: the extrinsic and the named terms."""
    everything = np.arange(PARAMETERS)
    parts = [everything[EXTRINSIC], *(
        everything[columns] for name, columns in TERM_COLUMNS.items() if name in terms)]
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Chain:
    """Pose pairs in the form that the model uses.

    Attributes
    ----------
    poses_a : (N, 4, 4), sensor a in its world.
    twist_a : (N, 6), metres and radians a second in the axes of a, from the neighbouring poses.
    step_rotation, step_translation : (N - 1, 3, 3) and (N - 1, 3), the motion of b, ``dB_k``.
    step_arc : (N - 1, 3, 3), metres: the length of the step times the identity.
    step_length : (N - 1), metres, from the speed around the step; at least a tenth of the mean.
    step_turn : (N - 1), squared radians, from the rate of turn around the step.

    Where every n-th pose is taken, n steps in one, their lengths and squared turns are added up,
    so that variances by them are the same whatever n; the arcs, too, each turned to the axes in
    which the step in one begins.

    pool : memory for the evaluations of the chain.

    """

    poses_a: FloatArray
    twist_a: FloatArray
    step_rotation: FloatArray
    step_translation: FloatArray
    step_arc: FloatArray
    step_length: FloatArray
    step_turn: FloatArray
    pool: Pool = field(default_factory=Pool)

    def __len__(self) -> int:
        return len(self.poses_a)

    @classmethod
    def from_pairs(cls, pairs: PosePairs, every: int = 1) -> Chain:
        """Take every n-th pair of poses."""
        poses_a, poses_b = pairs.poses_a[::every], pairs.poses_b[::every]
        duration = np.diff(pairs.stamps_ns[::every]) * 1e-9
        steps = se3.inverse(poses_b[:-1]) @ poses_b[1:]
        twist = np.empty((len(poses_a), 6))
        step_twist = se3.log_se3(se3.inverse(poses_a[:-1]) @ poses_a[1:]) / duration[:, None]
        twist[0], twist[-1] = step_twist[0], step_twist[-1]
        twist[1:-1] = 0.5 * (step_twist[:-1] + step_twist[1:])
        arc, length, turn = (
            part[:len(steps) * every].reshape(len(steps), every, *part.shape[1:]).sum(axis=1)
            for part in _driven(pairs))
        return cls(
            poses_a=poses_a,
            twist_a=twist,
            step_rotation=np.ascontiguousarray(steps[:, :3, :3]),
            step_translation=np.ascontiguousarray(steps[:, :3, 3]),
            step_arc=poses_b[:-1, :3, :3].transpose(0, 2, 1) @ arc,
            step_length=length,
            step_turn=turn,
        )


def _driven(pairs: PosePairs) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return of all K - 1 steps of b the arcs in its world, the lengths and the squared turns."""
    R = pairs.poses_b[:, :3, :3]
    duration = np.diff(pairs.stamps_ns) * 1e-9
    length = np.linalg.norm(np.diff(pairs.poses_b[:, :3, 3], axis=0), axis=1)
    # The matrices of two rotations differ by the root of eight times the sine of half the angle.
    chord = np.sqrt(np.square(np.diff(R, axis=0)).sum(axis=(1, 2)) / 8)
    rate = 2 * np.arcsin(np.minimum(chord, 1.0)) / duration
    return (R[:-1] * length[:, None, None], _typical_length(length, duration),
            duration**2 * _mean_around(rate**2, _TURN_WINDOW))


def _typical_length(length: FloatArray, duration: FloatArray) -> FloatArray:
    """Return (n,) lengths of steps of (n,) seconds at the speed of their neighbourhood.

    A step's own length would do, were it not noisy: a step that noise made long would be allowed
    the more noise, and the likelihood would take white noise for a walk.
    """
    mean = float(length.mean())
    if mean == 0:
        return np.ones(len(length))
    speed = (_mean_around(length, _SPEED_WINDOW) / _mean_around(duration, _SPEED_WINDOW))
    return speed * duration + _REST_SHARE * mean


def _mean_around(values: FloatArray, window: int) -> FloatArray:
    """Return the (n,) running means over an odd number of values, fewer at the ends."""
    half = window // 2
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    means: FloatArray = (total[last] - total[first]) / (last - first)
    return means


@dataclass(frozen=True, eq=False)
class State:
    """Values of the unknowns.

    Attributes
    ----------
    T_a_b : (4, 4), the extrinsic.
    bodies : (N, 4, 4), sensor b in the world of a.
    scale, systematic_drift, time_offset : the global terms; the drift is (3,).

    """

    T_a_b: FloatArray
    bodies: FloatArray
    scale: float
    systematic_drift: FloatArray
    time_offset: float

    @classmethod
    def start(cls, chain: Chain, T_a_b: FloatArray) -> State:
        """Put sensor b where a sees it."""
        return cls(T_a_b, chain.poses_a @ T_a_b, 1.0, np.zeros(3), 0.0)

    def moved(self, parameters: FloatArray, bodies: FloatArray) -> State:
        """Return the state after the steps (PARAMETERS,) and (N, 6)."""
        return replace(
            self,
            T_a_b=perturb(self.T_a_b, parameters[EXTRINSIC]),
            bodies=perturb(self.bodies, bodies),
            scale=self.scale + float(parameters[6]),
            systematic_drift=self.systematic_drift + parameters[7:10],
            time_offset=self.time_offset + float(parameters[10]),
        )


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals and their derivatives for n consecutive poses and their steps.

    Attributes
    ----------
    observation : (n, 6, 6 + m + 1), derivatives by the body and the m global columns, residual.
    walk : (n', 6, 12 + m + 1), derivatives by both bodies and the global columns, residual.

    """

    observation: FloatArray
    walk: FloatArray


def perturb(poses: FloatArray, steps: FloatArray) -> FloatArray:
    """Return ``t + R rho``, ``R exp(phi)`` of (..., 4, 4) poses and (..., 6) steps."""
    R = poses[..., :3, :3]
    return se3.from_rotation_translation(
        R @ se3.exp_so3(steps[..., 3:]), poses[..., :3, 3] + _apply(R, steps[..., :3]))


def linearise(
    chain: Chain, state: State, columns: IndexArray, first: int, last: int,
    into: Linearisation | None = None,
) -> Linearisation:
    """Linearise the residuals of the poses first to last - 1 and of the steps from them.

    ``columns`` are the indices of the m global parameters that are estimated; the result is
    written ``into`` arrays that are given.
    """
    poses, steps = (slice(first, min(last, end)) for end in (len(chain), len(chain) - 1))
    if into is None:
        m = len(columns)
        into = Linearisation(np.empty((poses.stop - first, 6, 7 + m)),
                             np.empty((steps.stop - first, 6, 13 + m)))
    _linearise_observation(chain, state, columns, poses, into.observation)
    _linearise_walk(chain, state, columns, steps, into.walk)
    return into


def _linearise_observation(
    chain: Chain, state: State, columns: IndexArray, poses: slice, result: FloatArray,
) -> None:
    predicted = chain.poses_a[poses]
    if state.time_offset:
        predicted = predicted @ se3.exp_se3(state.time_offset * chain.twist_a[poses])
    predicted = predicted @ state.T_a_b
    bodies = state.bodies[poses]
    R_t = predicted[:, :3, :3].transpose(0, 2, 1)
    relative = R_t @ bodies[:, :3, :3]
    translation = _apply(R_t, bodies[:, :3, 3] - predicted[:, :3, 3])
    rotation = se3.log_so3(relative)
    left_inverse = se3.left_jacobian_so3_inverse(rotation)
    result.fill(0.0)
    result[:, :3, :3] = relative
    result[:, 3:, 3:6] = left_inverse.transpose(0, 2, 1)
    # The extrinsic moves the prediction; its six columns always come first.
    result[:, :3, 6:9] = -np.eye(3)
    result[:, :3, 9:12] = se3.skew(translation)
    result[:, 3:, 9:12] = -left_inverse
    place = np.flatnonzero(columns == TERM_COLUMNS['time_offset'].start)
    if len(place):
        moved = chain.twist_a[poses] @ se3.adjoint(se3.inverse(state.T_a_b)).T
        result[:, :, 6 + place[0]] = _apply(result[:, :, 6:12], moved)
    result[:, :3, -1] = translation
    result[:, 3:, -1] = rotation


def _linearise_walk(
    chain: Chain, state: State, columns: IndexArray, steps: slice, result: FloatArray,
) -> None:
    start = state.bodies[steps]
    end = state.bodies[steps.start + 1:steps.stop + 1]
    p = chain.step_translation[steps]
    dR_t = chain.step_rotation[steps].transpose(0, 2, 1)
    R_t = start[:, :3, :3].transpose(0, 2, 1)
    moved = _apply(R_t, end[:, :3, 3] - start[:, :3, 3])
    relative = dR_t @ (R_t @ end[:, :3, :3])
    expected, by_drift = corrected_steps(
        p, chain.step_arc[steps], state.scale, state.systematic_drift)
    rotation = se3.log_so3(relative)
    left_inverse = se3.left_jacobian_so3_inverse(rotation)
    result.fill(0.0)
    result[:, :3, :3] = -dR_t
    result[:, :3, 3:6] = dR_t @ se3.skew(moved)
    result[:, 3:, 3:6] = -left_inverse @ dR_t
    result[:, :3, 6:9] = relative
    result[:, 3:, 9:12] = left_inverse.transpose(0, 2, 1)
    for j, column in enumerate(columns[6:], start=18):
        if column == TERM_COLUMNS['scale'].start:
            result[:, :3, j] = -_apply(dR_t, expected / state.scale)
        elif column < TERM_COLUMNS['systematic_drift'].stop:
            axis = int(column) - TERM_COLUMNS['systematic_drift'].start
            result[:, :3, j] = _apply(dR_t, by_drift[:, :, axis])
    result[:, :3, -1] = _apply(dR_t, moved - expected)
    result[:, 3:, -1] = rotation


def corrected_steps(
    steps: FloatArray, arcs: FloatArray, scale: float, drift: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return what (n, 3) steps p of b truly were, u = ``s (p - f W d)``, and -du/dd (n, 3, 3).

    W, ``arcs``, is ``|p|`` where a step is one. The drift d is counted per metre truly moved, so
    that ``s f |p|`` is the length of the result: the positive root of
    ``f^2 (1 - d^2) + 2 f e.d - 1 = 0``, e the direction of p. Where a thinned chain has several
    steps in one, the drift turned with the sensor on the way, and the root is that of the chord:
    exact to first order of the drift.
    """
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    direction = steps / np.maximum(length, np.finfo(float).tiny)
    along = direction @ drift
    root = np.sqrt(along**2 + 1.0 - drift @ drift)
    share = (root - along) / (1.0 - drift @ drift)
    drifted = arcs @ drift
    result = scale * (steps - share[:, None] * drifted)
    # Differentiating the quadratic: df/dd = -f (e - f d) / (f (1 - d^2) + e.d).
    by_share = -(share / root)[:, None] * (direction - share[:, None] * drift)
    derivative = scale * (
        share[:, None, None] * arcs + drifted[:, :, None] * by_share[:, None, :])
    return result, derivative


def _apply(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return (matrices @ vectors[..., None])[..., 0]
