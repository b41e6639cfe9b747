# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of many answers, or of two rigs, as text, CSV and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
import io
import json
from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM
from trajectory_calibration.fleet.comparison import Comparison, Entry, row
from trajectory_calibration.outputs.answer import answer_rows, NAMES, sizes, TO_DEGREES
from trajectory_calibration.rig.comparison import Change, RigComparison

_UNITS = {'z': ' [m]', 'yaw': ' [deg]'}
_HEAD = ('', 'date', *(f'{name}{_UNITS.get(name, "")}' for name in NAMES), 'findings')

_MAX_FINDINGS = 2


def to_text(comparison: Comparison) -> str:
    """Return the verdict, then one line per answer."""
    rows = [_HEAD, *(cells_of(entry, _MAX_FINDINGS) for entry in comparison.entries)]
    widths = [max(len(cells[k]) for cells in rows if len(cells) > 3) for k in range(len(_HEAD))]
    lines = [*comparison.describe(), '']
    for cells in rows:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=False)]
        lines.append('  '.join(padded).rstrip())
    legend = ['+-: 1 standard deviation; unknown: not determined by the motion']
    if comparison.changes:
        legend.append('A | B: the extrinsic changed between A and B, in sigma (standard '
                      'deviations); chi2/dof: about 1 by chance')
    return '\n'.join([*lines, '', *legend]) + '\n'


def to_csv(comparison: Comparison) -> str:
    """Return one row per answer, with the units in the column names."""
    return csv_text([
        {name: f'{value:.9g}' if isinstance(value, float) else value
         for name, value in row(entry).items()} for entry in comparison.entries])


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows with the same keys as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def to_json(comparison: Comparison) -> str:
    """Return the comparison as a JSON object in one line."""
    return json.dumps(comparison.to_dict()) + '\n'


def cells_of(entry: Entry, most: int | None = None) -> tuple[str, ...]:
    """Return name, date, six numbers ('0.209 +- 0.063', 'unknown') and at most ``most`` findings.

    For an entry without an answer: its name, 'no answer' or 'repeated', and the reason.
    """
    result = entry.result
    if result is None:
        return entry.name, 'repeated' if entry.repeated else 'no answer', entry.failure
    date = (result.start_utc or '').replace('T', ' ').removesuffix('Z')
    codes = list(dict.fromkeys(found.code for found in result.findings))
    more = [] if most is None or len(codes) <= most else [f'+{len(codes) - most}']
    return (entry.name, date, *map(str, answer_rows(result)), ' '.join(codes[:most] + more))


def rig_to_text(found: RigComparison) -> str:
    """Return the verdict, then one line per sensor."""
    lines = [str(found), '', (f'  in {found.base:<11}{"moved by, mm":>18}{"deg":>18}'
                              f'{"chi-squared":>16}  verdict')]
    for item in found.sensors:
        (t, R), (s_t, s_R) = sizes(item.step), sizes(item.std)
        unknown = ', '.join(np.array(DEGREES_OF_FREEDOM)[np.isnan(item.std)])
        lines.append(f'  {item.sensor:<14}{f"{1e3 * t:.1f} +- {1e3 * s_t:.1f}":>18}'
                     f'{f"{R:.3f} +- {s_R:.3f}":>18}'
                     f'{f"{item.chi_squared:.1f} of {item.degrees}":>16}  '
                     f'{_verdict(found, item)}{f" ({unknown} not compared)" if unknown else ""}')
    lines += [f'  {name:<14}{"not compared":>18}' for name in found.missing]
    return '\n'.join(lines) + '\n'


def rig_to_data(found: RigComparison) -> dict[str, Any]:
    """Return plain data, ready for JSON."""
    return {
        'holds': None if found.same_recording else found.holds,
        'same_recording': found.same_recording, 'base': found.base, 'sensors': _rows(found),
        'moved': [item.sensor for item in found.changes], 'not_compared': list(found.missing),
        'chi_squared': found.chi_squared, 'degrees_of_freedom': found.degrees,
        'p_value': found.p_value}


def _rows(found: RigComparison) -> list[dict[str, str | float | int | None]]:
    """Return a row per sensor: verdict, step and standard deviations, chi-squared test."""
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
    return ('cannot tell' if found.same_recording or not item.degrees else
            'as the base moved' if found.base in moved else 'holds')
