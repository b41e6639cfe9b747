# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories with a known extrinsic: the paper's generator, and what real sensors add to it.

``simulate(SCENARIOS['mixture'], seed=1)`` gives two trajectories and the truth.
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
