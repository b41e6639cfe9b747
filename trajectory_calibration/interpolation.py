"""Poses of a trajectory between its stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration import se3
from trajectory_calibration.se3 import FloatArray

# A neighbour turned by more than this may have turned the other way round.
_FARTHEST_TURN = np.pi / 2


def interpolate(
    stamps_ns: NDArray[np.int64],
    poses: FloatArray,
    at_ns: NDArray[np.int64],
    *,
    max_gap_ns: int | None,
) -> FloatArray:
    """Return the (K, 4, 4) poses of a trajectory at (K,) times.

    Between two poses: the cubic through these two and one more on either side, in the tangent
    space at the geodesic's point. It is exact where the twist is constant, its error falls with
    the fourth power of the step where the motion is smooth (that of the geodesic: with the
    second), and it is the same path in whichever frames the sensor and its world are, for the
    tangents of ``G T X`` are those of ``T`` times a matrix. At the ends, and beside a gap longer
    than ``max_gap_ns``, the quadratic through three poses.

    The geodesic remains where stamps are so uneven that the squared weights add up to more than
    1, so that no guess is noisier than a pose is.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Strictly increasing, N >= 2.
    poses : (N, 4, 4)
        Of the trajectory.
    at_ns : (K,) int64
        Times outside the span continue the first and the last geodesic.
    max_gap_ns : int or None
        The longest gap beyond which a pose still tells of the path; None: any.

    """
    left = np.clip(np.searchsorted(stamps_ns, at_ns), 1, len(stamps_ns) - 1) - 1
    since, gap = at_ns - stamps_ns[left], stamps_ns[left + 1] - stamps_ns[left]
    result = se3.interpolate(poses[left], poses[left + 1], since / gap)
    between = np.flatnonzero((since > 0) & (since < gap))
    around = left[between, None] + np.arange(-1, 3)
    known = (around >= 0) & (around < len(stamps_ns))
    around = np.clip(around, 0, len(stamps_ns) - 1)
    if max_gap_ns is not None:
        known[:, [0, 3]] &= np.diff(stamps_ns[around], axis=1)[:, [0, 2]] <= max_gap_ns
    origin = se3.inverse(result[between])
    tangents = np.stack([se3.log_se3(origin @ poses[k]) for k in around.T], axis=1)
    known &= np.linalg.norm(tangents[..., 3:], axis=-1) <= _FARTHEST_TURN
    weights = _lagrange((stamps_ns[around] - at_ns[between, None]) * 1e-9, known)
    sound = np.einsum('ij,ij->i', weights, weights) <= 1
    steps = np.einsum('ij,ijk->ik', weights[sound], tangents[sound])
    between = between[sound]
    result[between] = result[between] @ se3.exp_se3(steps)
    return result


def _lagrange(nodes: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return (K, M) weights of the known of (K, M) nodes for the polynomial's value at zero."""
    weights = known.astype(np.float64)
    count = nodes.shape[1]
    for k in range(count):
        for other in range(count):
            if other != k:
                weights[:, k] *= np.divide(
                    nodes[:, other], nodes[:, other] - nodes[:, k], out=np.ones(len(nodes)),
                    where=known[:, other] & known[:, k])
    return weights
