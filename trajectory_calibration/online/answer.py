# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The answer of ``~/calibrate``: text, and one line of JSON."""

from __future__ import annotations

import json

import numpy as np

from trajectory_calibration.online.options import in_node_words
from trajectory_calibration.outputs.screen import std_texts, transform_texts
from trajectory_calibration.result import CalibrationResult

# Before each line except the first. ``ros2 service call`` prints a line break as the two
# characters \n; there the dash separates the lines.
_NEXT_LINE = '\n - '


def headline(result: CalibrationResult) -> str:
    """Return the extrinsic in one line; 'unknown' for unobservable components."""
    words = transform_texts(result, 4, 5)
    return (f'{result.frame_a} -> {result.frame_b}: translation [{", ".join(words[:3])}] m, '
            f'rotation xyzw [{", ".join(words[3:])}]')


def deviations(result: CalibrationResult) -> str:
    """Return the standard deviations in one line, '' if the solver gave none."""
    if result.covariance is None:
        return ''
    words = std_texts(result.covariance)
    return f'[{", ".join(words[:3])}] m, about xyz [{", ".join(words[3:])}] deg'


def describe(result: CalibrationResult, *notes: str) -> str:
    """Return the extrinsic, its accuracy, the findings, and a last line of JSON.

    ``notes`` are additional lines, on the saved file and TF; empty ones are left out.
    """
    lines = [headline(result)]
    if result.covariance is not None:
        lines.append(f'standard deviations: {deviations(result)}')
    if result.observability.unobserved:
        lines.append(f'unobservable: {", ".join(result.observability.unobserved)}')
    if result.scale != 1.0:
        lines.append(f'scale: {result.scale:.5f}, multiplies the positions of {result.frame_b}')
    if result.time_offset_s or result.clock_drift:
        drift = f', changing by {1e6 * result.clock_drift:+.1f} ppm' if result.clock_drift else ''
        lines.append(f'clock offset: {result.time_offset_s:+.4f} s{drift}, added to the stamps of '
                     f'{result.frame_b}')
    lines.append(
        f'data: {result.motions:,} motions of {result.poses:,} poses; '
        f'fit residual {result.metrics.e_rt:.4f} m, {np.rad2deg(result.metrics.e_rR):.3f} deg per '
        'motion (not the accuracy)')
    lines += filter(None, notes)
    lines += [f'{finding.level}: {in_node_words(finding.text)}' for finding in result.findings]
    return f'{_NEXT_LINE.join(lines)}\n{summary(result)}'


def summary(result: CalibrationResult) -> str:
    """Return the main results in one line of JSON; ``~/result`` has everything."""
    data = result.to_dict()
    pose = data['T_a_b']
    return json.dumps({
        **{name: data[name] for name in ('frame_a', 'frame_b', 'scale', 'time_offset_s')},
        **{name: pose[name] for name in ('translation_m', 'rotation_xyzw', 'status')},
        'translation_std_m': data['std_m'],
        'rotation_std_deg': data['std_deg'],
        'findings': [finding.code for finding in result.findings],
    })
