# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``benchmarks/bags.py`` prints the table that ``docs/dependencies.md`` shows."""

from pathlib import Path

import pytest

from benchmarks import bags

pytestmark = pytest.mark.once
DOCUMENT = Path(__file__).resolve().parents[2] / 'docs' / 'dependencies.md'


def rows(text):
    return [[cell.strip() for cell in line.strip('|').split('|')]
            for line in text.splitlines() if line.count('|') == 8]


def test_the_script_prints_the_table_of_the_document(capsys):
    bags.main(['--messages', '300', '--damaged', '12'])
    printed, shown = (rows(text) for text in (
        capsys.readouterr().out, DOCUMENT.read_text(encoding='utf-8')))
    assert printed[0] == shown[0]
    assert [row[0] for row in printed] == [row[0] for row in shown]
    for row in printed[2:]:
        assert int(row[4]) >= int(row[5])
