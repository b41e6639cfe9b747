# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The style of docstrings, as ``ament_pep257`` checks it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.linter
@pytest.mark.pep257
def test_pep257():
    # D213 would move every summary to the second line; numpydoc has it on the first.
    main = pytest.importorskip('ament_pep257.main', reason='ament_pep257 is not installed')
    paths = ('trajectory_calibration', 'demo', 'launch', 'setup.py')
    argv = [*(str(ROOT / path) for path in paths), '--add-ignore', 'D213']
    assert main.main(argv=argv) == 0
