"""What several test modules need: the published data, and isolation of ROS."""

from pathlib import Path

import pytest

_DATA = Path(__file__).resolve().parents[1].parent / 'shared' / 'data'


@pytest.fixture(scope='session')
def shared_data():
    """Return the folder of the paper's published trajectories and results, or skip."""
    if not (_DATA / 'README.md').exists():
        pytest.skip(f'the published data is not beside the project: no {_DATA}')
    return _DATA
