# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's figures, from the paper's trajectories."""

from functools import lru_cache

import numpy as np
from published import kitti, kitti_figures, REFERENCES, SEQUENCES, simulation_figures, simulations
import pytest

from benchmarks.paper.kitti import paper_pairs
from trajectory_calibration import calibrate, CalibrationConfig
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation


def errors(solver, motions, T_a_b_true, **settings):
    return errors_of(load_solver(solver)(motions, CalibrationConfig(**settings)), T_a_b_true)


def errors_of(solution, T_a_b_true):
    found = absolute_errors(solution.T_a_b, T_a_b_true)
    return found.e_at, np.rad2deg(found.e_aR)


@lru_cache
def by_the_program(data, sequence, reference):
    """Return the motions of a sequence, and what dnlo finds with the published c and program."""
    motions = select_motions(paper_pairs(*kitti(data, sequence)[:2]), reference)
    return motions, load_solver('dnlo')(motions, CalibrationConfig(
        dnlo_c=1e-4, dnlo_method='ipopt'))


@pytest.mark.parametrize('reference', ['A', *REFERENCES])
@pytest.mark.parametrize('solver', ['park', 'taylor', 'dnl', 'ali', 'zhuang', 'dnlo'])
@pytest.mark.parametrize('sequence', SEQUENCES)
def test_kitti_table(shared_data, sequence, solver, reference):
    """To 0.001 m and 0.005 degrees; dnlo with the c and the program of the published table."""
    a, b, truth = kitti(shared_data, sequence)
    if solver == 'dnlo':
        e_at, e_aR = errors_of(by_the_program(shared_data, sequence, reference)[1], truth)
    else:
        e_at, e_aR = errors(solver, select_motions(paper_pairs(a, b), reference), truth)
    published = kitti_figures(shared_data)[sequence, solver, reference]
    assert e_at == pytest.approx(published[0], abs=0.001)
    assert e_aR == pytest.approx(published[1], abs=0.005)


@pytest.mark.parametrize('method', ['auto', 'path'])
@pytest.mark.parametrize('reference', REFERENCES)
def test_dnlo_in_closed_form_finds_no_higher_cost_than_the_program(
        shared_data, reference, method):
    for sequence in SEQUENCES:
        motions, program = by_the_program(shared_data, sequence, reference)
        found = load_solver('dnlo')(motions, CalibrationConfig(dnlo_c=1e-4, dnlo_method=method))
        assert found.cost <= program.cost * (1 + 1e-3)


def test_stated_c_keeps_the_figure_of_the_lidar_sequence(shared_data):
    """2011_09_30 at B10 does not depend on c: half the motions are above both values."""
    a, b, truth = kitti(shared_data, SEQUENCES[0])
    e_at, e_aR = errors('dnlo', select_motions(paper_pairs(a, b), 'B10'), truth)
    assert e_at == pytest.approx(0.202, abs=0.001)
    assert e_aR == pytest.approx(0.232, abs=0.005)


@pytest.fixture(scope='module')
def simulation_medians(shared_data, every):
    """Return the median (e_at, e_aR) over one run in ``every``, and the published.

    By kind, level, solver, reference.
    """
    found = {}
    published = {key: np.median(values[::every], axis=0)
                 for key, values in simulation_figures(shared_data).items()}
    for kind, level, _, a, b, truth in simulations(shared_data, every):
        pairs = associate_by_interpolation(a, b, max_gap_ns=None)
        for reference in REFERENCES:
            motions = select_motions(pairs, reference)
            for solver in ('park', 'taylor', 'dnl', 'zhuang', 'dnlo'):
                key = kind, level, solver, reference
                found.setdefault(key, []).append(errors(solver, motions, truth))
    return {key: np.median(values, axis=0) for key, values in found.items()}, published


# Two of the 19 runs of each class and level, or all.
FEW_AND_ALL = pytest.mark.parametrize(
    'every', [10, pytest.param(1, marks=pytest.mark.slow)], scope='module')


@pytest.mark.statistical
@FEW_AND_ALL
@pytest.mark.parametrize('solver', ['park', 'taylor', 'dnl', 'zhuang'])
def test_simulation_medians(simulation_medians, solver):
    """Within 2 % at every class, level and B and C; a micrometre is nothing where it is zero."""
    found, published = simulation_medians
    keys = [key for key in found if key[2] == solver]
    assert len(keys) == 19 * len(REFERENCES)
    for key in keys:
        np.testing.assert_allclose(
            found[key], published[key], rtol=0.02, atol=1e-6, err_msg=str(key))


@pytest.mark.statistical
@FEW_AND_ALL
def test_simulation_medians_of_dnlo(simulation_medians):
    """Within 5 % of the published median, or below it."""
    found, published = simulation_medians
    for key, median in found.items():
        if key[2] == 'dnlo':
            assert (median <= 1.05 * published[key] + 1e-6).all(), key


@pytest.mark.usefixtures('noise_identified_once')
@pytest.mark.parametrize('every', [20, pytest.param(1, marks=pytest.mark.slow)])
def test_no_solver_fails_without_noise(shared_data, every):
    """The published rows of Zhuang do, started at the identity."""
    noise_free = [(kind, 0) for kind in ('noise', 'outliers', 'drift')]
    runs = list(simulations(shared_data, cases=noise_free))
    assert len(runs) == 57
    for kind, _, run, a, b, truth in runs[::every]:
        for solver in ('dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang'):
            for reference in REFERENCES:
                result = calibrate(a, b, CalibrationConfig(solver=solver, reference=reference))
                assert result.absolute_errors(truth).e_at < 1e-9, (kind, run, solver)
