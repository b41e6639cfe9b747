# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Laws of the drift-aware solver that need no truth: what must not change the answer."""

from dataclasses import replace
import subprocess
import sys

from motion_data import random_pose
import numpy as np
import pytest
from test_drift_aware import as_pairs, AUTO, simulated

from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers.drift_aware import solve_pairs

NOISE = {'white': (0.01, 0.004), 'walk': (0.01, 0.002)}


def chi_square(one, other):
    """Return the squared difference of two answers by their stated deviations, over six."""
    step = se3.step_between(one.T_a_b, other.T_a_b)
    return step @ np.linalg.solve(0.5 * (one.covariance + other.covariance), step) / 6


@pytest.fixture(scope='module')
def found():
    """Return pairs and answers of three drives."""
    pairs = [simulated(seed, poses=600, **NOISE)[0] for seed in (30, 31, 32)]
    return [(one, solve_pairs(one, AUTO)) for one in pairs]


def test_worlds_as_large_as_utm_change_no_digit(found):
    rng = np.random.default_rng(0)
    for pairs, answer in found:
        moved = as_pairs(
            pairs.stamps_ns * 1e-9, random_pose(rng, distance=6e6) @ pairs.poses_a,
            random_pose(rng, distance=6e6) @ pairs.poses_b)
        other = solve_pairs(moved, AUTO)
        np.testing.assert_allclose(other.T_a_b, answer.T_a_b, atol=1e-5)
        np.testing.assert_allclose(other.covariance, answer.covariance, rtol=1e-3, atol=1e-9)


def test_swapped_sensors(found):
    for pairs, answer in found:
        back = solve_pairs(replace(pairs, poses_a=pairs.poses_b, poses_b=pairs.poses_a), AUTO)
        forth = replace(back, T_a_b=se3.inverse(back.T_a_b), covariance=answer.covariance)
        assert chi_square(answer, forth) < 0.5
        assert back.scale * answer.scale == pytest.approx(1.0, abs=0.003)


def test_reversed_time(found):
    for pairs, answer in found:
        stamps = pairs.stamps_ns[0] + pairs.stamps_ns[-1] - pairs.stamps_ns[::-1]
        other = solve_pairs(replace(pairs, stamps_ns=stamps, poses_a=pairs.poses_a[::-1],
                                    poses_b=pairs.poses_b[::-1]), AUTO)
        assert chi_square(answer, other) < 0.5


@pytest.mark.parametrize('every', [2, 5])
def test_thinned(found, every):
    for pairs, answer in found:
        assert chi_square(answer, solve_pairs(pairs.thinned(every), AUTO)) < 1.5


def test_scipy_is_not_needed_for_an_answer():
    code = ('import sys; import trajectory_calibration.solvers.drift_aware.solver; '
            'print([name for name in sys.modules if name.startswith("scipy.") and '
            'name.split(".")[1] in ("optimize", "special", "stats")])')
    out = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == '[]'
