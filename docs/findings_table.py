# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write the table of findings.md anew from the catalogue: run this file."""

from pathlib import Path

from trajectory_calibration.data.findings import CATALOGUE, LEVELS

PAGE = Path(__file__).with_name('findings.md')
START = '| code | level | meaning |'


def table() -> str:
    """Return the codes, worst first."""
    rows = sorted(CATALOGUE.items(), key=lambda item: (LEVELS.index(item[1][0]), item[0]))
    lines = [START, '|---|---|---|']
    lines += [f'| `{code}` | {level} | {meaning} |' for code, (level, meaning) in rows]
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    text = PAGE.read_text(encoding='utf-8')
    PAGE.write_text(text[:text.index(START)] + table(), encoding='utf-8')
