"""The code style of ROS, as ``ament_flake8`` checks it."""

from pathlib import Path

import pytest

main = pytest.importorskip('ament_flake8.main', reason='ament_flake8 is not installed')
ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    paths = [str(ROOT / name) for name in ('trajectory_calibration', 'test', 'demo', 'setup.py')]
    code, errors = main.main_with_errors(argv=paths)
    assert code == 0, '\n'.join(errors)
