"""A result, and an inspection, as a person reads them on a terminal."""

from __future__ import annotations

from collections.abc import Iterable
import textwrap
from typing import Any

import numpy as np

from trajectory_calibration.assessment.excitation import UNKNOWN
from trajectory_calibration.assessment.observability import Observability, OBSERVED
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult

# Columns of a terminal, and of them the most that a label takes: a longer one has its own line.
_WIDTH = 80
_LONGEST_LABEL = 30

_KNOWN = 0.5 * UNKNOWN


def format_result(result: CalibrationResult, T_a_b_true: FloatArray | None = None) -> str:
    """Return the screen of a result: warnings, the transform, how good it is, how it was made."""
    a, b = result.frame_a, result.frame_b
    R, t = result.T_a_b[:3, :3], result.T_a_b[:3, 3]
    rows = {
        'translation': f'{_named(t, "xyz", 4)} m',
        'quaternion': _named(se3.rotation_to_quaternion(R), 'xyzw', 6),
        'rotation': f'{_named(roll_pitch_yaw_deg(R), ("roll", "pitch", "yaw"), 3)} deg',
    }
    if result.covariance is not None:
        words = [f'{name} {word}' for name, word in zip(
            'xyzxyz', deviation_words(result.covariance), strict=True)]
        rows['1 sigma along'] = f'{"  ".join(words[:3])} m'
        rows['1 sigma about'] = f'{"  ".join(words[3:])} deg'
    rows['observed'] = _describe_status(result.observability)
    reference = result.reference or result.config.reference
    rows['relative error'] = (
        f'{result.metrics.e_rt:.4f} m, {np.rad2deg(result.metrics.e_rR):.3f} deg, mean over the '
        f'motions at {reference}')
    if T_a_b_true is not None:
        error = result.absolute_errors(T_a_b_true)
        rows['absolute error'] = (f'{error.e_at:.4f} m, {np.rad2deg(error.e_aR):.3f} deg, '
                                  'against the ground truth')
    rows['turned about'] = (
        f'{_named(result.observability.excitation_deg, "xyz", 2)} deg rms per motion, axes of {a}')
    rows['data'] = _describe_data(result)
    if result.scale != 1.0:
        rows['scale'] = f'{_describe_scale(result)} on the translations of {b}'
    if result.time_offset_s:
        rows['time offset'] = f'{_fixed(result.time_offset_s, 4)} s on {b}'
    if result.clock_drift:
        rows['clock drift'] = f'{1e6 * result.clock_drift:+.1f} ppm on {b}, zero in its middle'
    rows['method'] = f'{result.config.solver}, version {result.version}'
    rows['reference'] = result.reference_choice or reference
    lines = [line for warning in result.warnings
             for line in _wrapped(f'warning: {warning}', '', '  ')]
    if lines:
        lines.append('')
    lines.append(f'Pose of {b} in {a}')
    lines += _aligned(rows)
    return '\n'.join(lines) + '\n'


def deviation_words(covariance: FloatArray) -> list[str]:
    """Return the six standard deviations of a (6, 6) covariance, metres and degrees.

    From half of what stands for a direction of which nothing is known on, the number says no
    more than 'unknown'.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    words = [_fixed(value, 4) for value in sigma[:3]]
    words += [_fixed(value, 3) for value in np.rad2deg(sigma[3:])]
    # Written so that NaN is unknown.
    known = sigma < _KNOWN
    return [word if is_known else 'unknown' for word, is_known in zip(words, known, strict=True)]


def format_inspection(found: dict[str, Any]) -> str:
    """Return the screen of what was found in one file or bag."""
    lines = [found['path'], *_warnings(found['notes'])]
    for item in found['trajectories']:
        # A file is its trajectory; a bag holds several.
        if item['name'] != found['path']:
            lines += ['', f'{item["name"]}  ({item["kind"]})']
        messages = item.get('messages', item['poses'])
        read = '' if messages == item['poses'] else f' of {messages} messages'
        if item['kind'].endswith('/Path'):
            read = f' in the last of {messages} messages'
        gaps = (f'{item["gaps"]} gaps, the longest {item["longest_gap_s"]:.3f} s' if item['gaps']
                else 'no gaps')
        lines += _warnings(item['warnings'])
        lines += _aligned({
            'frames': ('not named in the file' if item['sensor_frame'] is None
                       else f'{item["sensor_frame"]} in {item["world_frame"]}'),
            'poses': f'{item["poses"]}{read}, {item["rate_hz"]:.2f} Hz, {gaps}',
            'time': f'{item["duration_s"]:.3f} s from {item["start_s"]:.3f}',
            'path': f'{item["path_length_m"]:.2f} m',
            'turned about': f'{_named(item["turned_deg"], "xyz", 2)} deg rms in 2 s',
            'motion': f'{item["motion"]}: {item["advice"]}',
        })
    if found['other']:
        lines += ['', 'Topics that cannot serve']
        lines += _aligned({
            item['topic']: item.get('error') or f'{item["msgtype"]}, {item["messages"]} messages'
            for item in found['other']})
    return '\n'.join(lines) + '\n'


def _describe_status(observability: Observability) -> str:
    """Return which directions the motion determined, and which badly or not."""
    by_status: dict[str, list[str]] = {}
    for name, status in observability.status.items():
        by_status.setdefault(status, []).append(name)
    observed = by_status.pop(OBSERVED, [])
    if not by_status:
        return 'all six directions'
    rest = '; '.join(f'{status}: {", ".join(names)}' for status, names in by_status.items())
    return f'{", ".join(observed) or "none"}; {rest}'


def _describe_scale(result: CalibrationResult) -> str:
    """Return the scale to six digits, also in another unit, and its deviation if it has one."""
    deviation = (result.diagnosis or {}).get('scale_deviation')
    # That of what was found on top of the setting.
    known = '' if deviation is None else f' +- {result.config.scale * deviation:#.2g}'
    return f'{result.scale:#.6g}{known}'


def _describe_data(result: CalibrationResult) -> str:
    summary = result.association
    kept = '' if result.inliers is None else f', {np.count_nonzero(result.inliers)} kept'
    return (f'{result.poses} pairs ({summary.method}) of {summary.poses_a} and '
            f'{summary.poses_b} poses, {result.motions} motions{kept}')


def roll_pitch_yaw_deg(R: FloatArray) -> FloatArray:
    """Return the angles about the fixed x, then y, then z axis, as URDF and tf write them."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        # Roll and yaw turn about the same axis there; yaw takes none of it.
        roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
    else:
        roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    angles: FloatArray = np.rad2deg(np.array([roll, pitch, yaw]))
    return angles


def _named(values: Iterable[float], names: Iterable[str], digits: int) -> str:
    return '  '.join(
        f'{name} {_fixed(value, digits)}' for name, value in zip(names, values, strict=True))


def _fixed(value: float, digits: int) -> str:
    """Return a number with so many decimals, and no minus before a zero."""
    return f'{round(float(value), digits) + 0.0:.{digits}f}'


def _warnings(warnings: Iterable[str]) -> list[str]:
    return [line for warning in warnings
            for line in _wrapped(f'warning: {warning}', '  ', '    ')]


def _wrapped(text: str, first: str, rest: str) -> list[str]:
    """Break a text into lines of the width of a terminal, paths and names left whole."""
    return textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=rest,
                         break_long_words=False, break_on_hyphens=False)


def _aligned(rows: dict[str, str]) -> list[str]:
    """Return labels and values in two columns, long values broken under their own column."""
    width = min(max(map(len, rows)), _LONGEST_LABEL)
    lines = []
    for name, value in rows.items():
        head = f'  {name:<{width}}  '
        if len(name) > width:
            lines.append(head.rstrip())
            head = ' ' * (width + 4)
        lines += _wrapped(value, head, ' ' * (width + 4))
    return lines
