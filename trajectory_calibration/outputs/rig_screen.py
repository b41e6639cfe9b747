# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A rig as a person reads it on a terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trajectory_calibration.data.findings import worst_first
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.rig.result import COMPONENTS, RigResult, SensorAnswer

_STYLES = {'observed': 'ok', 'weak': 'weak', 'unobserved': 'unknown', 'prior': 'prior'}
_NAMES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')

# Findings that are shown without -v.
_MOST_FINDINGS = 5


def format_rig(
    rig: RigResult, *, truth: Mapping[str, FloatArray] | None = None, verbose: bool = False,
    terminal: Terminal | None = None,
) -> str:
    """Return the screen of a rig: the sensors, then what a person should know.

    ``truth`` adds the errors against known (4, 4) poses in the base.
    """
    terminal = terminal or Terminal()
    lines = []
    for base, names in rig.trees.items():
        lines.append(terminal.paint(f'Rig of {len(names)} sensors in {base}', 'head')
                     + terminal.paint(f'   p_{base} = T p_sensor, m and deg', 'soft'))
        lines.append(terminal.paint(
            f'  {"":<14}' + ''.join(f'{name:>20}' for name in _NAMES), 'soft'))
        lines += [_row(rig.sensors[name], terminal) for name in names if name != base]
    lines += [terminal.paint(f'  {name:<14}{"no answer":>20}', 'unknown')
              for name in rig.unplaced if name not in rig.sensors]
    lines.append(terminal.paint(
        '  +- standard deviation; w: weak, p: from the prior, unknown: not determined', 'soft'))
    lines.append('')
    lines += _second_table(rig, terminal)
    if truth:
        lines += ['', *_errors(rig, truth)]
    if rig.degrees:
        lines.append(f'\nloops close with chi-squared {rig.chi_squared:.1f} of {rig.degrees} '
                     f'degrees of freedom (p = {rig.p_value:.2g})')
    findings = worst_first(rig.findings)
    shown = findings if verbose else findings[:_MOST_FINDINGS]
    if shown:
        lines.append('')
        for found in shown:
            head = f'{found.level}: '
            lines += terminal.wrapped(f'{head}{found.text}', rest=' ' * len(head))
    if len(shown) < len(findings):
        lines.append(f'and {len(findings) - len(shown)} more: -v')
    if verbose:
        lines += ['', *_pairs(rig)]
    return '\n'.join(lines) + '\n'


def values_of(sensor: SensorAnswer) -> tuple[FloatArray, FloatArray]:
    """Return (6,) x, y, z, roll, pitch, yaw and their deviations, metres and degrees."""
    T = sensor.T_base_sensor
    values = np.concatenate([T[:3, 3], np.rad2deg(se3.roll_pitch_yaw(T[:3, :3]))])
    std = np.sqrt(np.maximum(np.diagonal(sensor.covariance), 0.0))
    std[3:] = np.rad2deg(std[3:])
    return values, std


def _row(sensor: SensorAnswer, terminal: Terminal) -> str:
    values, std = values_of(sensor)
    cells = []
    for k, component in enumerate(COMPONENTS):
        status = sensor.status[component]
        mark = {'weak': ' w', 'prior': ' p'}.get(status, '')
        words = ('unknown' if status == 'unobserved' else
                 f'{values[k]:.3f} +- {std[k]:.3f}{mark}' if k < 3 else
                 f'{values[k]:.2f} +- {std[k]:.2f}{mark}')
        cells.append(terminal.paint(f'{words:>20}', _STYLES.get(status, 'ok')))
    return f'  {sensor.name:<14}' + ''.join(cells)


def _second_table(rig: RigResult, terminal: Terminal) -> list[str]:
    """Return clock, scale and noise of each sensor."""
    lines = [terminal.paint(
        f'  {"":<14}{"clock, ms":>16}{"scale":>18}{"white, mm":>12}{"deg":>8}'
        f'{"drift, mm/sqrt m":>19}{"deg/sqrt m":>12}', 'soft')]
    for sensor in rig.sensors.values():
        offset, std = 1e3 * sensor.clock.offset_s, 1e3 * sensor.clock.offset_std_s
        clock = '-' if sensor.name == sensor.base else f'{offset + 0.0:+.1f} +- {std:.1f}'
        scale = ('1' if sensor.scale == 1.0 else
                 f'{sensor.scale:.4f} +- {sensor.scale_std:.4f}')
        noise = [''] * 4 if sensor.noise is None else [
            f'{1e3 * sensor.noise.white_m:.2g}', f'{np.rad2deg(sensor.noise.white_rad):.2g}',
            f'{1e3 * sensor.noise.drift_m:.2g}', f'{np.rad2deg(sensor.noise.drift_rad):.2g}']
        lines.append(f'  {sensor.name:<14}{clock:>16}{scale:>18}{noise[0]:>12}{noise[1]:>8}'
                     f'{noise[2]:>19}{noise[3]:>12}'.rstrip())
    return lines


def _errors(rig: RigResult, truth: Mapping[str, FloatArray]) -> list[str]:
    lines = []
    for name in rig.free:
        if name in truth:
            step = se3.step_between(truth[name], rig.sensors[name].T_base_sensor)
            lines.append(f'  error of {name} against the ground truth: '
                         f'{np.linalg.norm(step[:3]):.4f} m, '
                         f'{np.rad2deg(np.linalg.norm(step[3:])):.3f} deg')
    return lines


def _pairs(rig: RigResult) -> list[str]:
    lines = ['  pairs: chi-squared of six degrees of freedom against the rig']
    for pair in rig.pairs:
        words = pair.failure or (
            'no other pair checks it' if np.isnan(pair.chi_squared) else
            f'{pair.chi_squared:.1f}')
        unused = '' if pair.used or pair.failure else ' (not used)'
        lines.append(f'    {pair.parent} - {pair.child}: {words}{unused}')
    return lines
