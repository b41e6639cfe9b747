# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The code style of ROS, as ``ament_flake8`` checks it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    main = pytest.importorskip('ament_flake8.main', reason='ament_flake8 is not installed')
    paths = ('trajectory_calibration', 'demo', 'launch', 'test', 'setup.py')
    code, errors = main.main_with_errors(argv=[
        '--config', str(ROOT / 'test' / 'flake8.ini'), *(str(ROOT / path) for path in paths)])
    assert code == 0, '\n'.join(errors)
