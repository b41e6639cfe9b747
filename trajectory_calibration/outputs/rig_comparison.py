# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two rigs side by side, as text, CSV and plain data: one row for each sensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajectory_calibration.outputs.answer import TO_DEGREES
from trajectory_calibration.outputs.comparison_table import csv_text
from trajectory_calibration.rig.comparison import Change, RigComparison


def format_comparison(found: RigComparison) -> str:
    """Return the verdict, then one line for each sensor."""
    lines = [str(found), '', (f'  in {found.base:<11}{"moved by, mm":>18}{"deg":>18}'
                              f'{"chi-squared":>16}  verdict')]
    for item in found.sensors:
        # The lengths of what is known.
        (t, R), (s_t, s_R) = (
            np.sqrt(np.nansum(np.reshape(TO_DEGREES * values, (2, 3)) ** 2, axis=1))
            for values in (item.step, item.std))
        unknown = ', '.join(np.array(COMPONENTS)[np.isnan(item.std)])
        lines.append(f'  {item.sensor:<14}{f"{1e3 * t:.1f} +- {1e3 * s_t:.1f}":>18}'
                     f'{f"{R:.3f} +- {s_R:.3f}":>18}'
                     f'{f"{item.chi_squared:.1f} of {item.degrees}":>16}  '
                     f'{_verdict(found, item)}{f" ({unknown} not compared)" if unknown else ""}')
    lines += [f'  {name:<14}{"not compared":>18}' for name in found.missing]
    return '\n'.join(lines) + '\n'


def comparison_csv(found: RigComparison) -> str:
    """Return one row for each sensor, the units in the names of the columns."""
    return csv_text(_rows(found))


def comparison_data(found: RigComparison) -> dict[str, Any]:
    """Return plain data, ready for JSON."""
    return {
        'holds': found.holds, 'base': found.base, 'sensors': _rows(found),
        'moved': [item.sensor for item in found.changes], 'not_compared': list(found.missing),
        'chi_squared': found.chi_squared, 'degrees_of_freedom': found.degrees,
        'p_value': found.p_value}


def _rows(found: RigComparison) -> list[dict[str, str | float | int | None]]:
    """Return what is told of each sensor: metres, degrees, chi-squared, verdict."""
    rows = []
    for item in found.sensors:
        row: dict[str, str | float | int | None] = {
            'sensor': item.sensor, 'verdict': _verdict(found, item)}
        for k, name in enumerate(('x_m', 'y_m', 'z_m', 'x_deg', 'y_deg', 'z_deg')):
            for kind, values in (('d', item.step), ('std_', item.std)):
                known = np.isfinite(values[k])
                row[kind + name] = float(TO_DEGREES[k] * values[k]) if known else None
        row.update(chi_squared=item.chi_squared, degrees_of_freedom=item.degrees,
                   p_value=item.p_value)
        rows.append(row)
    return rows


def _verdict(found: RigComparison, item: Change) -> str:
    moved = {change.sensor for change in found.changes}
    if item.sensor in moved:
        return 'moved'
    return ('cannot tell' if not item.degrees else
            'as the base moved' if found.base in moved else 'holds')
