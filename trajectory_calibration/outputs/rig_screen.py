# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A rig as text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trajectory_calibration.errors import counted
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import error_text, NAMES, pose_rows, Row
from trajectory_calibration.outputs.screen import finding_lines
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.rig.result import RigResult, SensorAnswer

# Marks beside a number, by its status word.
_MARKS = {'weak': 'w', 'prior': 'p', 'unknown': '', 'ok': ''}

# Findings that are shown without -v.
_MAX_FINDINGS = 5


def format_rig(
    rig: RigResult, *, truth: Mapping[str, FloatArray] | None = None, verbose: bool = False,
    terminal: Terminal | None = None,
) -> str:
    """Return the text of a rig: sensors, then findings.

    ``truth`` adds errors against ground truth: (4, 4) poses in the base, by sensor.
    """
    terminal = terminal or Terminal()
    lines = []
    for base, names in rig.trees.items():
        lines.append(terminal.paint(f'Rig of {counted(len(names), "sensor")} in {base}', 'head')
                     + terminal.paint(f'   p_{base} = T p_sensor, m and deg', 'soft'))
        lines.append(terminal.paint(
            f'  {"":<14}' + ''.join(f'{name:>20}' for name in NAMES), 'soft'))
        lines += [_row(rig, rig.sensors[name], terminal) for name in names if name != base]
    lines += [terminal.paint(f'  {name:<14}{"no answer":>20}', 'unknown')
              for name in rig.unplaced if name not in rig.sensors]
    lines.append(terminal.paint(
        '  +- standard deviation; w: weak, p: from the prior, unknown: not determined', 'soft'))
    lines.append('')
    lines += _second_table(rig, terminal)
    if truth:
        lines += ['', *(f'  error of {name} against the ground truth: ' + error_text(
            rig.sensors[name].T_base_sensor, truth[name], rig.sensors[name].status)
            for name in rig.free if name in truth)]
    if rig.degrees:
        lines += ['', loops_text(rig)]
    lines += finding_lines(rig.findings, terminal, None if verbose else _MAX_FINDINGS)
    if verbose:
        lines += ['', '  pairs: chi-squared and degrees of freedom against the rig']
        for pair in rig.pairs:
            unused = '' if pair.used or pair.failure else ' (not used)'
            lines.append(f'    {pair.parent} - {pair.child}: {pair.words}{unused}')
    return '\n'.join(lines) + '\n'


def loops_text(rig: RigResult) -> str:
    """Return the chi-squared test of the loops as text."""
    if not rig.degrees:
        return 'no loop checks the answer'
    verdict = 'disagree:' if rig.p_value < FALSE_ALARM else 'close with'
    return (f'loops {verdict} chi-squared {rig.chi_squared:.1f} of {rig.degrees} degrees of '
            f'freedom (p = {rig.p_value:.2g})')


def sensor_rows(rig: RigResult, sensor: SensorAnswer) -> tuple[Row, ...]:
    """Return x, y, z, roll, pitch, yaw of a sensor in its base, with standard deviations."""
    return pose_rows(sensor.T_base_sensor, sensor.covariance, sensor.status,
                     rig.config.calibration)


def clock_text(sensor: SensorAnswer) -> str:
    """Return the clock offset and its standard deviation, ms."""
    return f'{1e3 * sensor.clock.offset_s + 0.0:+.1f} +- {1e3 * sensor.clock.offset_std_s:.1f}'


def scale_text(sensor: SensorAnswer) -> str:
    """Return the scale and its standard deviation."""
    return '1' if sensor.scale == 1.0 else f'{sensor.scale:.4f} +- {sensor.scale_std:.4f}'


def noise_texts(sensor: SensorAnswer) -> list[str]:
    """Return the noise of a pose, mm and deg, and its drift after 1 m; '' if unknown."""
    noise = sensor.noise
    return [''] * 4 if noise is None else [f'{value:.2g}' for value in (
        1e3 * noise.white_m, np.rad2deg(noise.white_rad),
        1e3 * noise.drift_m, np.rad2deg(noise.drift_rad))]


def _row(rig: RigResult, sensor: SensorAnswer, terminal: Terminal) -> str:
    cells = [terminal.paint(f'{row} {_MARKS[row.word]}'.rstrip().rjust(20), row.word)
             for row in sensor_rows(rig, sensor)]
    return f'  {sensor.name:<14}' + ''.join(cells)


def _second_table(rig: RigResult, terminal: Terminal) -> list[str]:
    """Return clock, scale and noise of each sensor."""
    form = '  {:<14}{:>16}{:>18}{:>12}{:>8}{:>19}{:>12}'
    lines = [terminal.paint(form.format(
        '', 'clock offset, ms', 'scale', 'noise, mm', 'deg', 'drift, mm/sqrt m', 'deg/sqrt m'),
        'soft')]
    for sensor in rig.sensors.values():
        clock = '-' if sensor.name == sensor.base else clock_text(sensor)
        lines.append(form.format(
            sensor.name, clock, scale_text(sensor), *noise_texts(sensor)).rstrip())
    return [*lines, terminal.paint('  clock offset: added to the stamps; noise: of each pose; '
                                   'drift: random walk, after 1 m', 'soft')]
