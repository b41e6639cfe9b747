# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What several test modules need: the published data, and examples that may take their time."""

from dataclasses import replace
from pathlib import Path

from hypothesis import HealthCheck, settings
import pytest

from trajectory_calibration.assessment import covariance, reference_selection

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


@pytest.fixture(scope='module')
def _identified():
    return {}


@pytest.fixture
def noise_identified_once(monkeypatch, _identified):
    """Let the noise of the same poses be identified once in a module, whichever solver asks."""
    identify = covariance.most_likely

    def remembered(pairs, config):
        key = (pairs.stamps_ns.tobytes(), pairs.poses_a.tobytes(), pairs.poses_b.tobytes(),
               replace(config, solver='drift_aware', reference='B1'))
        if key not in _identified:
            _identified[key] = identify(pairs, config)
        return _identified[key]

    for module in (covariance, reference_selection):
        monkeypatch.setattr(module, 'most_likely', remembered)


@pytest.fixture(autouse=True)
def _no_width_of_a_terminal(monkeypatch):
    """Take away the width that a shell, or a process of a parallel run, has set."""
    monkeypatch.delenv('COLUMNS', raising=False)
