# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated trajectories with a known extrinsic: the paper's generator with more sensor errors.

``simulate(SCENARIOS['mixture'], seed=1)`` returns two trajectories and the true extrinsic.
"""

from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, hills, peaks, Unicycle, Wander
from trajectory_calibration.simulation.scenario import (
    paper_scenario,
    Scenario,
    SCENARIOS,
    Sensor,
    simulate,
    SimulatedPair,
    with_noise,
)

__all__ = [
    'SCENARIOS',
    'Noise',
    'Scenario',
    'Sensor',
    'SimulatedPair',
    'Unicycle',
    'Wander',
    'flat',
    'hills',
    'paper_scenario',
    'peaks',
    'simulate',
    'with_noise',
]
