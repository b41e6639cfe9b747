# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The registry: capabilities are data, and other packages add to it (docs/add_a_solver.md)."""

from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.solvers import (
    DEFAULT_SOLVER,
    load_solver,
    noise_identifier,
    solver_info,
    SOLVER_NAMES,
    solvers,
    solvers_that_estimate,
)

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'add_a_solver.md'
PACKAGE = Path(__file__).resolve().parents[2] / 'trajectory_calibration'


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install the example of the page: its module and its entry point."""
    python, toml = (re.search(rf'```{kind}\n(.*?)```', PAGE.read_text(encoding='utf-8'),
                              re.DOTALL)[1] for kind in ('python', 'toml'))
    (tmp_path / 'my_solvers.py').write_text(python, encoding='utf-8')
    info = tmp_path / 'my_solvers-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: my-solvers\nVersion: 1.0\n')
    entry = re.search(r'short_motions = "(.*)"', toml)[1]
    (info / 'entry_points.txt').write_text(
        f'[trajectory_calibration.solvers]\nshort_motions = {entry}\n'
        'plain = my_solvers:solve\n', encoding='utf-8')
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop('my_solvers', None)


@pytest.mark.usefixtures('installed')
def test_the_example_of_the_page_calibrates():
    run = simulate(SCENARIOS['noise'], 1)
    found = calibrate(run.a, run.b, CalibrationConfig(solver='short_motions'))
    errors = found.absolute_errors(run.T_a_b)
    assert errors.e_at < 0.2
    assert np.linalg.eigvalsh(found.covariance).min() >= 0
    assert solver_info('short_motions').sentence == 'translations aligned, then the lever arm'
    plain = solver_info('plain')
    assert plain.needs_reference
    assert plain.sentence.startswith('Align the translations')
    assert [row.name for row in solvers()] == [*SOLVER_NAMES, 'short_motions', 'plain']


@pytest.mark.usefixtures('installed')
def test_the_command_line_knows_it(tmp_path):
    run = simulate(SCENARIOS['noise'], 1)
    for name, trajectory in (('a', run.a), ('b', run.b)):
        poses = trajectory.poses
        rows = np.column_stack([trajectory.stamps_ns * 1e-9, poses[:, :3, 3],
                                se3.rotation_to_quaternion(poses[:, :3, :3])])
        np.savetxt(tmp_path / f'{name}.tum', rows, fmt='%.9f')
    done = subprocess.run(
        [sys.executable, '-m', 'trajectory_calibration', 'calibrate', 'a.tum', 'b.tum',
         '--solver', 'short_motions', '--format', 'json'],
        cwd=tmp_path, env={'PYTHONPATH': f'{tmp_path}:{PACKAGE.parent}', 'PATH': ''},
        capture_output=True, text=True, check=False)
    assert done.returncode in (0, 3), done.stderr
    assert '"short_motions"' in done.stdout


@pytest.mark.usefixtures('installed')
def test_an_unknown_name_lists_all_that_are_known():
    with pytest.raises(ConfigError, match='needed one of ' + ', '.join(SOLVER_NAMES) + ', short'):
        solver_info('tsai')
    with pytest.raises(ConfigError, match="solver 'tsai' is unknown; needed one of dnl, dnlo"):
        CalibrationConfig(solver='tsai')


def test_the_defaults_are_in_the_registry():
    assert DEFAULT_SOLVER in SOLVER_NAMES
    assert CalibrationConfig().solver == DEFAULT_SOLVER
    assert noise_identifier().identifies_noise
    assert solvers_that_estimate('scale')
    # One function under two names.
    assert load_solver('park') is load_solver('taylor')


def test_what_a_solver_cannot_estimate_is_refused_by_its_capabilities():
    for row in solvers():
        for term in ('scale', 'systematic_drift'):
            if term in row.estimates:
                CalibrationConfig(solver=row.name, **{f'{term}_mode': 'estimate'})
            else:
                with pytest.raises(ConfigError, match=f'{term}_mode is estimate'):
                    CalibrationConfig(solver=row.name, **{f'{term}_mode': 'estimate'})


@pytest.mark.parametrize('folder', ['pipeline.py', 'config', 'data', 'time_alignment'])
def test_no_solver_is_named_outside_the_registry(folder):
    """Behaviour follows from capabilities: a solver of another package is no stranger."""
    place = PACKAGE / folder
    for path in place.rglob('*.py') if place.is_dir() else [place]:
        text = path.read_text(encoding='utf-8')
        for name in SOLVER_NAMES:
            assert not re.search(rf"'{name}'", text), f'{path} names {name}'
