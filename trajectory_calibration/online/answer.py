"""The answer of ``~/calibrate`` in words."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.screen import deviation_words
from trajectory_calibration.result import CalibrationResult

# Begins every line but the first. ``ros2 service call`` prints a line break as the two
# characters \n; the dash keeps the lines apart there, too.
_NEXT_LINE = '\n - '


def headline(result: CalibrationResult) -> str:
    """Return the extrinsic in one line."""
    x, y, z = result.T_a_b[:3, 3]
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3])
    return (f'{result.frame_a} -> {result.frame_b}: translation [{x:.4f}, {y:.4f}, {z:.4f}] m, '
            f'rotation xyzw [{qx:.5f}, {qy:.5f}, {qz:.5f}, {qw:.5f}]')


def deviations(result: CalibrationResult) -> str:
    """Return the standard deviations in one line, '' where the solver gave none."""
    if result.covariance is None:
        return ''
    words = deviation_words(result.covariance)
    return f'[{", ".join(words[:3])}] m, about xyz [{", ".join(words[3:])}] deg'


def describe(result: CalibrationResult, file: str = '') -> str:
    """Return the extrinsic and how good it is for a person, one thing a line.

    Parameters
    ----------
    result : CalibrationResult
        To describe.
    file : str
        A sentence about where it was saved; '' where it was not.

    """
    lines = [headline(result)]
    if result.covariance is not None:
        lines.append(f'standard deviations: {deviations(result)}')
    if result.observability.unobserved:
        lines.append(f'not observed: {", ".join(result.observability.unobserved)}')
    if result.scale != 1.0:
        lines.append(f'scale of {result.frame_b}: {result.scale:.5f}')
    if result.time_offset_s or result.clock_drift:
        drift = f', changing by {1e6 * result.clock_drift:+.1f} ppm' if result.clock_drift else ''
        lines.append(f'clock of {result.frame_b}: {result.time_offset_s:+.4f} s{drift}')
    lines.append(
        f'data: {result.motions} motions of {result.poses} poses, e_rt '
        f'{result.metrics.e_rt:.4f} m, e_rR {np.rad2deg(result.metrics.e_rR):.3f} deg')
    if file:
        lines.append(file)
    lines += [f'warning: {warning}' for warning in result.warnings]
    return _NEXT_LINE.join(lines)
