# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What several test modules need: the published data, and examples that may take their time."""

from pathlib import Path

from hypothesis import HealthCheck, settings
import pytest

_DATA = Path(__file__).resolve().parents[1].parent / 'shared' / 'data'

# A busy machine is no failure: how long an example takes is not what these tests are about.
settings.register_profile(
    'unhurried', deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
settings.load_profile('unhurried')


@pytest.fixture(scope='session')
def shared_data():
    """Return the folder of the paper's published trajectories and results, or skip."""
    if not (_DATA / 'README.md').exists():
        pytest.skip(f'the published data is not beside the project: no {_DATA}')
    return _DATA


@pytest.fixture(autouse=True)
def _no_width_of_a_terminal(monkeypatch):
    """Take away the width that a shell, or a process of a parallel run, has set."""
    monkeypatch.delenv('COLUMNS', raising=False)
