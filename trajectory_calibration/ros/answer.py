"""The answer of ``~/calibrate`` in words."""

from __future__ import annotations

import numpy as np

from trajectory_calibration import se3
from trajectory_calibration.result import CalibrationResult

# A standard deviation beyond these stands for a direction of which nothing is known.
_UNKNOWN_M, _UNKNOWN_DEG = 100.0, 90.0


def describe(result: CalibrationResult) -> str:
    """Return the extrinsic and how good it is in one line for a person."""
    x, y, z = result.T_a_b[:3, 3]
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3])
    parts = [
        f'{result.frame_a} -> {result.frame_b}: translation [{x:.4f}, {y:.4f}, {z:.4f}] m',
        f'rotation xyzw [{qx:.5f}, {qy:.5f}, {qz:.5f}, {qw:.5f}]',
    ]
    if result.covariance is not None:
        sigma = np.sqrt(np.diag(result.covariance))
        metres = ', '.join(
            f'{value:.4f}' if value < _UNKNOWN_M else 'unknown' for value in sigma[:3])
        degrees = ', '.join(
            f'{value:.3f}' if value < _UNKNOWN_DEG else 'unknown'
            for value in np.rad2deg(sigma[3:]))
        parts.append(f'standard deviations [{metres}] m, [{degrees}] deg')
    if result.scale != 1.0:
        parts.append(f'scale of {result.frame_b} {result.scale:.5f}')
    if result.time_offset_s:
        parts.append(f'clock of {result.frame_b} {result.time_offset_s:+.4f} s')
    parts.append(
        f'{result.motions} motions of {result.poses} poses, e_rt {result.metrics.e_rt:.4f} m, '
        f'e_rR {np.rad2deg(result.metrics.e_rR):.3f} deg')
    if result.warnings:
        parts.append(f'warnings: {" | ".join(result.warnings)}')
    return '; '.join(parts)
