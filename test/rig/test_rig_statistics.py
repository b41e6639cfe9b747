# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rigs over seeds, thinned: ``python -m benchmarks.rig`` has the long ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from thinning import thinned

from benchmarks.simulated_rig import Fault, rig_scenario, RigScenario, simulate_rig
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM, quantile
from trajectory_calibration.rig import calibrate_rig, RigConfig, SensorSettings
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.scenario import Sensor

pytestmark = pytest.mark.statistical

FREE = RigConfig(sensors={'mono': SensorSettings(scale='free')})


def test_joint_covariance_is_consistent():
    nees, inside = [], []
    for seed in range(8):
        run = simulate_rig(rig_scenario(3, 60.0), seed)
        rig = calibrate_rig(run.trajectories, FREE)
        error = np.concatenate([se3.step_between(
            run.T_base_sensor[name], rig.sensors[name].T_base_sensor) for name in rig.free])
        nees.append(error @ np.linalg.solve(rig.covariance, error) / len(error))
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diagonal(rig.covariance)))
        assert all(item.kind == 'clock' for item in rig.contradictions)
    # Not above chi-squared, and not below the caution that docs/rig.md states.
    numbers = np.size(inside)
    assert 0.61 * quantile(numbers, 1 - FALSE_ALARM) < numbers * np.mean(nees) < quantile(numbers)
    # Coverage of 95 % intervals: below this number once in a thousand times.
    assert np.sum(inside) >= binom.ppf(FALSE_ALARM, numbers, 0.95)


@thinned('seeds', 1, 3)
@pytest.mark.parametrize(('kind', 'fault'), [
    ('moved', Fault(moved=0.05)), ('clock', Fault(late=0.08)),
    ('vehicle', Fault(elsewhere=True))], ids=['moved', 'clock', 'vehicle'])
def test_faults_are_named(kind, fault, seeds):
    slam = Noise(white=0.005, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)
    # As long as in docs/rig.md, where 96 of 100 moved mounts are found; 90 s are too short for
    # 5 cm.
    base = RigScenario({name: Sensor(noise=slam) for name in 'abcd'}, 120.0)
    for seed in range(seeds):
        culprit = 'abcd'[(seed + 1) % 4]
        run = simulate_rig(replace(base, faults={culprit: fault}), 50 + seed)
        rig = calibrate_rig(run.trajectories)
        assert [(item.sensor, item.kind) for item in rig.contradictions] == [(culprit, kind)]
