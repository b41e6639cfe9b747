# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``benchmarks/speed.py`` prints the tables that ``docs/speed.md`` shows."""

import importlib.util
from pathlib import Path
import sys

import pytest

pytestmark = pytest.mark.once
ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / 'benchmarks' / 'speed.py'


def columns(line):
    return [cell.strip() for cell in line.strip().strip('|').split('|')]


@pytest.mark.skipif(not SCRIPT.exists(), reason='benchmarks/ is not here')
def test_the_script_prints_the_columns_and_targets_of_the_document(
        shared_data, monkeypatch, capsys):
    pytest.importorskip('casadi', reason='casadi is not installed')
    spec = importlib.util.spec_from_file_location('speed', SCRIPT)
    speed = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(speed)
    monkeypatch.setattr(speed, 'REPEATS', 1)
    monkeypatch.setattr(speed, 'LINES', 500)
    monkeypatch.setattr(sys, 'argv', [
        'speed.py', '--data', str(shared_data), '--poses', '60', '--long', '2000'])
    speed.main()
    printed, shown = (
        [columns(line) for line in text.splitlines() if line.startswith('|')]
        for text in (capsys.readouterr().out,
                     (ROOT / 'docs' / 'speed.md').read_text(encoding='utf-8')))
    whole, whole_shown = ([row for row in rows if len(row) == 3] for rows in (printed, shown))
    assert [(row[0].replace('2,000', '1,000,000'), row[2]) for row in whole] == [
        (row[0], row[2]) for row in whole_shown]
    printed, shown = ([row for row in rows if len(row) == 6] for rows in (printed, shown))
    assert printed[:2] == shown[:2]
    # Drive, motions and solver say which row it is; the last column is the target.
    targets = {tuple(row[:3]): row[5] for row in printed if row[0] == speed.PUBLISHED}
    assert targets == {tuple(row[:3]): row[5] for row in shown if row[0] == speed.PUBLISHED}
    assert {row[5] for row in printed if row[0].startswith('simulated')} == {''}
