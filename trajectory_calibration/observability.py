"""What the motion determined of an extrinsic, and what it did not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajectory_calibration import se3
from trajectory_calibration.motions import MotionPairs
from trajectory_calibration.se3 import FloatArray


@dataclass(frozen=True)
class Observability:
    """How well the motion excited each direction; axes are those of sensor a.

    Attributes
    ----------
    excitation_deg : root mean square rotation of a motion about x, y, z of a, degrees.
    translation_gain : three numbers, ascending: metres of residual, root mean square over the
        motions, per metre of error of the translation along each of ``translation_axes``.
    translation_axes : three unit vectors in a, weakest first.
    warnings : the weak directions in words.

    """

    excitation_deg: tuple[float, ...]
    translation_gain: tuple[float, ...]
    translation_axes: tuple[tuple[float, ...], ...]
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON or YAML."""
        return {
            'excitation_deg': list(self.excitation_deg),
            'translation_gain': list(self.translation_gain),
            'translation_axes': [list(axis) for axis in self.translation_axes],
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Observability:
        """Rebuild from ``to_dict``."""
        return cls(
            tuple(map(float, data['excitation_deg'])),
            tuple(map(float, data['translation_gain'])),
            tuple(tuple(map(float, axis)) for axis in data['translation_axes']))


def observe(motions: MotionPairs) -> Observability:
    """Measure what the rotations of the motions say about the extrinsic.

    The translation enters ``A X = X B`` only through ``(R_A - I) t``: along an axis that all
    rotations share it is not observed, and nearly so where they nearly share one.
    """
    R = motions.A[:, :3, :3]
    excitation = np.sqrt(np.mean(se3.log_so3(R) ** 2, axis=0))
    gain, axes = translation_gain(R)
    return Observability(
        tuple(np.rad2deg(excitation).tolist()),
        tuple(gain.tolist()),
        tuple(tuple(axis) for axis in axes.tolist()))


def translation_gain(rotations_a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (3,) ascending gains of ``(R_A - I) t`` and the (3, 3) axes as rows.

    ``rotations_a`` is (M, 3, 3); the gain is the root mean square over the motions.
    """
    D = rotations_a - np.eye(3)
    eigenvalues, eigenvectors = np.linalg.eigh(
        np.einsum('kij,kil->jl', D, D) / max(1, len(rotations_a)))
    axes = eigenvectors.T
    # An axis has no direction of its own; point it along its largest component.
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], axis=1)
    return np.sqrt(np.maximum(eigenvalues, 0.0)), axes * np.sign(largest)
