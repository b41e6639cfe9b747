# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two rigs side by side, as text, CSV and plain data: one row for each sensor."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.comparison import Change, RigComparison


def format_comparison(found: RigComparison) -> str:
    """Return the verdict, then one line for each sensor."""
    lines = [str(found), '', (f'  in {found.base:<11}{"moved by, mm":>18}{"deg":>18}'
                              f'{"chi-squared":>16}  verdict')]
    for item in found.sensors:
        (t, s_t), (R, s_R) = (
            (factor * _length(item.step[part]), factor * _length(item.std[part]))
            for factor, part in ((1e3, slice(3)), (180 / np.pi, slice(3, 6))))
        lines.append(f'  {item.sensor:<14}{f"{t:.1f} +- {s_t:.1f}":>18}'
                     f'{f"{R:.3f} +- {s_R:.3f}":>18}'
                     f'{f"{item.chi_squared:.1f} of {item.degrees}":>16}  '
                     f'{_verdict(found, item)}{_open(item)}')
    lines += [f'  {name:<14}{"not compared":>18}' for name in found.missing]
    return '\n'.join(lines) + '\n'


def comparison_csv(found: RigComparison) -> str:
    """Return one row for each sensor, the units in the names of the columns."""
    text = io.StringIO()
    rows = _rows(found)
    writer = csv.DictWriter(text, list(rows[0]), lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def comparison_data(found: RigComparison) -> dict[str, Any]:
    """Return plain data, ready for JSON."""
    return {
        'holds': found.holds, 'base': found.base, 'sensors': _rows(found),
        'moved': [item.sensor for item in found.changes], 'not_compared': list(found.missing),
        'chi_squared': found.chi_squared, 'degrees_of_freedom': found.degrees,
        'p_value': found.p_value}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rows(found: RigComparison) -> list[dict[str, str | float | int | None]]:
    """Return what is told of each sensor: metres, degrees, chi-squared, verdict."""
    return [{
        'sensor': item.sensor, 'verdict': _verdict(found, item),
        **{f'{kind}{axis}_{unit}': _number(factor * values[3 * turn + k])
           for turn, (unit, factor) in enumerate((('m', 1.0), ('deg', 180 / np.pi)))
           for k, axis in enumerate('xyz')
           for kind, values in (('d', item.step), ('std_', item.std))},
        'chi_squared': item.chi_squared, 'degrees_of_freedom': item.degrees,
        'p_value': item.p_value} for item in found.sensors]


def _length(values: FloatArray) -> float:
    """Return the length of what is known of a vector."""
    return float(np.sqrt(np.nansum(values**2)))


def _open(item: Change) -> str:
    names = [name for name, std in zip(DEGREES_OF_FREEDOM, item.std, strict=True) if np.isnan(std)]
    return f' ({", ".join(names)} not compared)' if names else ''


def _verdict(found: RigComparison, item: Change) -> str:
    moved = {change.sensor for change in found.changes}
    if item.sensor in moved:
        return 'moved'
    return ('cannot tell' if not item.degrees else
            'as the base moved' if found.base in moved else 'holds')
