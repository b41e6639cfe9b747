# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Steady errors of the sensors of a rig."""

from dataclasses import replace

import numpy as np

from benchmarks.simulated_rig import RigScenario, simulate_rig
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.scenario import Sensor

EXACT = RigScenario({'a': Sensor(), 'b': Sensor()}, 20.0)


def test_a_latency_makes_positions_late_and_leaves_attitudes():
    plain, late = (simulate_rig(replace(EXACT, latency=std), 3) for std in (0.0, 0.1))
    seconds = []
    for name in 'ab':
        one, other = plain.trajectories[name].poses, late.trajectories[name].poses
        np.testing.assert_array_equal(one[:, :3, :3], other[:, :3, :3])
        velocity = np.gradient(one[:, :3, 3], 0.1, axis=0)
        behind = one[:, :3, 3] - other[:, :3, 3]
        seconds.append(np.sum(behind * velocity) / np.sum(velocity**2))
        assert np.abs(behind - seconds[-1] * velocity).max() < 0.2 * np.abs(behind).max()
    assert abs(seconds[0] - seconds[1]) > 0.01


def test_a_steady_drift_is_that_of_sensors_that_drift():
    def driving(walk):
        noise = Noise(walk=walk)
        scenario = RigScenario({'a': Sensor(noise=noise), 'b': Sensor(noise=noise)}, 20.0)
        return [simulate_rig(replace(scenario, steady_drift=drift), 4).trajectories['b'].poses
                for drift in (0.0, 0.01)]

    one, other = driving(0.0)
    np.testing.assert_array_equal(one, other)
    one, other = driving(1e-6)
    way = np.linalg.norm(np.diff(one[:, :3, 3], axis=0), axis=1).sum()
    assert 1e-4 < np.linalg.norm((one - other)[-1, :3, 3]) / way < 0.05
