# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Laws that hold whatever the truth is, on simulated drives and on real pairs where they are."""

import numpy as np
import pytest

from benchmarks.drives import make
from benchmarks.families import trajectory
from benchmarks.laws import apart, fast_drives, inverted, judge, larger
from benchmarks.real import load_pairs
from trajectory_calibration.geometry import se3

pytestmark = pytest.mark.once
SAME = ('swap', 'reversed', 'thinned 2', 'thinned 5', 'world', 'third')


def simulated(name, seed=0, laws=SAME):
    run = make(name, seed, third='third' in laws)
    third = trajectory(run.third[0], 'c') if run.third else None
    return judge((name, trajectory(run.a, 'a'), trajectory(run.b, 'b'), third, laws))[1]


@pytest.mark.parametrize('name', ['hand-held', 'car, scale and drift'])
def test_a_change_of_the_input_changes_the_answer_as_it_must(name):
    found = simulated(name)
    assert set(found) == set(SAME)
    assert max(found.values()) < 4, found
    assert np.median(list(found.values())) < 1
    assert found['world'] < 0.01


def test_halves_of_a_drive_agree():
    found = [simulated('drone', seed, ('halves',))['halves'] for seed in range(3)]
    assert max(found) < 4
    assert np.mean(found) < 2


def test_recordings_at_10_50_and_200_hertz_agree():
    _, a, b = next(iter(fast_drives(0)))
    assert judge(('rate car', a, b, None, ('rate',)))[1]['rate'] < 4


@pytest.mark.parametrize('name', ['tum_fr2desk_gt_orb', 'kitti09_lidar_gnss'])
def test_real_pairs_obey(shared_data, name):
    if not (shared_data / 'real' / name).exists():
        pytest.skip(f'no {shared_data / "real" / name}')
    (pair,) = load_pairs(shared_data, name)
    found = judge((name, pair.a, pair.b, None, ('swap', 'reversed', 'thinned 2', 'world')))[1]
    assert max(found.values()) < 4, found


def test_a_covariance_turns_with_the_inverse_and_the_larger_one_bounds_both():
    rng = np.random.default_rng(0)
    T = se3.exp_se3(rng.normal(size=6))
    L = 1e-4 * rng.normal(size=(6, 6))
    P = L @ L.T
    back, Q = inverted(*inverted(T, P))
    assert back == pytest.approx(T, abs=1e-12)
    assert pytest.approx(P, rel=1e-6, abs=1e-14) == Q
    # To first order, draws of the one are draws of the other.
    d = rng.multivariate_normal(np.zeros(6), P, size=20_000)
    moved = se3.step_between(se3.inverse(T), se3.inverse(se3.moved(T, d)))
    assert np.cov(moved.T) == pytest.approx(inverted(T, P)[1], rel=0.1, abs=0.05 * P.max())
    R = 1e-4 * rng.normal(size=(6, 6))
    bound = larger(P, R @ R.T)
    for smaller in (P, R @ R.T):
        assert np.linalg.eigvalsh(bound - smaller).min() > -1e-12
    assert apart(T, se3.moved(T, d[0]), P, np.ones(6, bool)) == pytest.approx(
        d[0] @ np.linalg.solve(P, d[0]) / 6)
