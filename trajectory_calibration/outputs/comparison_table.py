# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many answers as text, CSV and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
import io
import json
from typing import Any

from trajectory_calibration.fleet.comparison import Comparison, Entry, row
from trajectory_calibration.outputs.answer import answer_rows, NAMES

_UNITS = {'z': ' [m]', 'yaw': ' [deg]'}
_HEAD = ('', 'date', *(f'{name}{_UNITS.get(name, "")}' for name in NAMES), 'findings')

_SHOWN_FINDINGS = 2


def to_text(comparison: Comparison) -> str:
    """Return the verdict, then one line for each answer."""
    rows = [_HEAD, *(cells_of(entry, _SHOWN_FINDINGS) for entry in comparison.entries)]
    widths = [max(len(cells[k]) for cells in rows if len(cells) > 3) for k in range(len(_HEAD))]
    lines = [*comparison.describe(), '']
    for cells in rows:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=False)]
        lines.append('  '.join(padded).rstrip())
    legend = ('value +- standard deviation, along the axes of a and of the angles; unknown: the '
              'motion does not determine it')
    return '\n'.join([*lines, '', legend]) + '\n'


def to_csv(comparison: Comparison) -> str:
    """Return one row for each answer, the units in the names of the columns."""
    return csv_text([
        {name: f'{value:.9g}' if isinstance(value, float) else value
         for name, value in row(entry).items()} for entry in comparison.entries])


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of equal names as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def to_json(comparison: Comparison) -> str:
    """Return everything as one JSON object."""
    return json.dumps(comparison.to_dict())


def cells_of(entry: Entry, most: int | None = None) -> tuple[str, ...]:
    """Return name, date, six numbers in words ('0.209 +- 0.063', 'unknown') and findings.

    At most ``most`` of the findings. Of an entry without an answer: its name and why.
    """
    result = entry.result
    if result is None:
        return entry.name, 'repeated' if entry.repeated else 'no answer', entry.failure
    date = (result.start_utc or '').replace('T', ' ').removesuffix('Z')
    codes = list(dict.fromkeys(found.code for found in result.findings))
    more = [] if most is None or len(codes) <= most else [f'+{len(codes) - most}']
    return (entry.name, date, *map(str, answer_rows(result)), ' '.join(codes[:most] + more))
