# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.paper``: what it computes, what it writes, and that it continues."""

from contextlib import nullcontext
import csv
from importlib.util import find_spec
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from benchmarks.paper import tasks
from benchmarks.paper.__main__ import main
from benchmarks.paper.claims import FAILS, HOLDS, judge, OPEN, PARTLY
from benchmarks.paper.comparison import compare_runs, compare_with_quartiles
from benchmarks.paper.environment import in_order
from benchmarks.paper.kitti import kitti_tasks, KittiTask, PUBLISHED_C, run_kitti_task, STATED_C
from benchmarks.paper.paper import PaperBenchmark, run_paper
from benchmarks.paper.published import (
    ERRORS,
    SEQUENCES,
    simulation_figures,
    simulation_quartiles,
    simulation_runs,
)
from benchmarks.paper.statistics import group, mean_interval, summarise
from benchmarks.paper.store import COLUMNS, ResultStore
from benchmarks.paper.tasks import (
    Cell,
    HARDEST,
    PAPER_SOLVERS,
    published_tasks,
    Record,
    REFERENCES,
    run_task,
    simulated_tasks,
    Task,
)
from trajectory_calibration.errors import (
    ConfigError,
    MissingPackageError,
    ResultError,
    SolverError,
    SourceError,
)
from trajectory_calibration.executor import Executor

pytestmark = [pytest.mark.once, pytest.mark.skipif(
    not (find_spec('joblib') and find_spec('matplotlib')),
    reason='joblib or matplotlib is not installed')]

QUICK = ('park', 'taylor')


def rows_of(path):
    with path.open(encoding='utf-8', newline='') as stream:
        return list(csv.DictReader(stream))


# --- Tasks ---

def test_the_full_set_of_the_paper():
    tasks = simulated_tasks(38, 0, PAPER_SOLVERS)
    assert len({(task.kind, task.level) for task in tasks}) == 19
    assert len(tasks) * len(PAPER_SOLVERS) * len(REFERENCES) == 25_992


def test_a_task_gives_every_solver_at_every_reference():
    task = Task('simulated', 'mixture', 0.0, 3, ('dnl', 'dnlo', 'park'))
    records = run_task(task).records
    assert [(item.solver, item.reference) for item in records] == [
        (solver, reference) for solver in task.solvers for reference in REFERENCES]
    assert [item.errors for item in records] == [item.errors for item in run_task(task).records]
    assert all(0 < item.e_at_m < 2 and not item.note for item in records)


def test_without_noise_the_answer_is_exact():
    for kind in ('noise', 'outliers', 'drift'):
        for item in run_task(Task('simulated', kind, 0.0, 5, ('dnl', 'ali', 'zhuang'))).records:
            assert max(item.errors) < 1e-9, item


def test_levels_reach_the_trajectories():
    quiet, loud = (run_task(Task('simulated', kind, level, 1, ('park',))).records
                   for kind, level in (('noise', 0.002), ('noise', 0.01)))
    for reference in range(len(REFERENCES)):
        assert loud[reference].e_at_m > 2 * quiet[reference].e_at_m
    assert run_task(Task('simulated', 'outliers', 4.0, 1, ('park',))).records[1].e_aR_deg < 1e-6


def test_a_solver_without_reference_has_one_row():
    (record,) = run_task(Task('simulated', 'mixture', 0.0, 3, ('drift_aware',))).records
    assert record.reference == '-'
    assert record.e_at_m < 0.05


def test_no_answer_is_a_record_with_the_reason(monkeypatch):
    load = tasks.load_solver

    def refuse(*_):
        raise SolverError('found nothing')

    monkeypatch.setattr(
        tasks, 'load_solver', lambda name: refuse if name == 'park' else load(name))
    records = run_task(Task('simulated', 'noise', 0.01, 0, QUICK)).records
    refused = [item for item in records if item.solver == 'park']
    assert {item.note for item in refused} == {'found nothing'}
    assert np.isnan([item.errors for item in refused]).all()
    summary = summarise(group(records))
    assert {row.failed for row in summary if row.solver == 'park'} == {1}
    assert {row.failed for row in summary if row.solver == 'taylor'} == {0}


# --- Published figures, number by number ---

def test_published_runs_agree_number_by_number(shared_data):
    runs = [item for item in simulation_runs(shared_data)
            if item.level == HARDEST[item.kind]][::9]
    assert {item.kind for item in runs} == set(HARDEST)
    records = [record for task in published_tasks(runs, ('park', 'taylor', 'dnl', 'zhuang'))
               for record in run_task(task).records]
    rows = compare_runs(records, simulation_figures(shared_data))
    assert len(rows) == 4 * len(REFERENCES)
    for row in rows:
        assert row.runs == len(runs)
        assert row.agree + row.lower + row.higher == row.runs
        # The published rows of Zhuang start at the identity and fail here and there.
        if row.solver != 'zhuang':
            assert row.agree == row.runs, row
    assert sum(row.higher for row in rows) == 0


def test_all_published_runs_are_found(shared_data, tmp_path):
    runs = simulation_runs(shared_data)
    assert len(runs) == 19 * 19
    assert len({(item.kind, item.level) for item in runs}) == 19
    with pytest.raises(SourceError, match='published data'):
        simulation_runs(tmp_path)


def test_own_medians_lie_in_the_published_quartiles(shared_data):
    """Of a handful of runs at the hardest mixture: dnl at every B and C."""
    records = [record for run in range(12) for record in run_task(
        Task('simulated', 'mixture', 0.0, run, ('dnl',))).records]
    rows = compare_with_quartiles(group(records), simulation_quartiles(shared_data), ('dnl',))
    inside = {(row.reference, row.error): row.inside for row in rows}
    assert len(inside) == 2 * len(REFERENCES)
    assert all(inside[reference, 'e_aR_deg'] for reference in REFERENCES[1:])
    for row in rows:
        assert row.q25 < row.median < row.q75
        assert row.inside == (row.q25 <= row.ours <= row.q75)


@pytest.mark.parametrize('sequence', SEQUENCES)
def test_kitti_records(shared_data, sequence):
    records = run_kitti_task(KittiTask(shared_data, sequence, 'C10'))
    assert [item.solver for item in records] == [*PAPER_SOLVERS, 'dnlo']
    assert [item.dnlo_c for item in records[-2:]] == [PUBLISHED_C, STATED_C]
    for item in records:
        assert np.hypot(item.along_m, item.across_m) == pytest.approx(item.e_at_m)
        assert np.hypot(item.corrected_along_m, item.corrected_across_m) == pytest.approx(
            item.corrected_e_at_m)
        same = item.corrected_e_at_m == item.e_at_m
        assert same == (sequence == SEQUENCES[0])
        if item.dnlo_c == PUBLISHED_C or item.solver != 'dnlo':
            np.testing.assert_allclose(item.errors, item.published, atol=0.003)


def test_kitti_tables_are_of_the_solvers_that_were_asked_for(shared_data, tmp_path, monkeypatch):
    monkeypatch.setattr('benchmarks.paper.figures.draw_all', lambda *_: [])
    benchmark = PaperBenchmark(
        tmp_path, shared_data, runs=1, solvers=('taylor', 'park'), executor=Executor(processes=1))
    text = run_paper(benchmark, lambda *_: None).read_text(encoding='utf-8')
    assert {row['solver'] for row in rows_of(tmp_path / 'kitti.csv')} == {'taylor', 'park'}
    chapter = text[text.index('## KITTI'):]
    assert '24 of 24 pairs' in chapter
    assert '| dnl | B5 |' not in chapter
    assert [task.solvers for task in kitti_tasks(shared_data, ('drift_aware', 'dnlo', 'ali'))] == [
        ('ali', 'dnlo')] * 2 * len(REFERENCES)
    assert kitti_tasks(shared_data, ('drift_aware',)) == []


# --- The results file ---

@pytest.fixture
def half_done(tmp_path):
    """Return a folder with the records of two tasks, and the tasks."""
    tasks = simulated_tasks(1, 0, QUICK)[:2]
    store = ResultStore(tmp_path / 'half')
    for task in tasks:
        store.append(run_task(task).records)
    return tmp_path / 'half', tasks


def test_columns(half_done):
    folder, tasks = half_done
    rows = rows_of(folder / 'runs.csv')
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == len(tasks) * len(QUICK) * len(REFERENCES)
    assert COLUMNS[6:10] == ERRORS


def test_what_is_read_is_what_was_written(half_done):
    folder, tasks = half_done
    again = ResultStore(folder)
    assert not again.missing(tasks)
    expected = [record for task in tasks for record in run_task(task).records]
    for found, record in zip(again.select(tasks), expected, strict=True):
        assert found.cell == record.cell
        np.testing.assert_allclose(found.errors, record.errors, rtol=1e-6)


@pytest.mark.parametrize('kept', [0, 10, 70, 200, 700, 1500, 1501, 2000])
def test_a_file_cut_off_anywhere_loses_no_more_than_the_last_solver(half_done, kept):
    folder, tasks = half_done
    path = folder / 'runs.csv'
    whole = path.read_bytes()
    path.write_bytes(whole[:kept])
    store = ResultStore(folder)
    missing = store.missing(tasks)
    assert missing
    # What is left is whole rows of whole solvers.
    left = rows_of(path)
    assert len(left) == len(REFERENCES) * (
        len(tasks) * len(QUICK) - sum(len(task.solvers) for task in missing))
    for task in missing:
        store.append(run_task(task).records)
    assert not ResultStore(folder).missing(tasks)
    assert len(rows_of(path)) == len(whole.splitlines()) - 1


def test_a_file_that_ends_in_zeros_is_read(half_done):
    """As a power cut leaves it."""
    folder, tasks = half_done
    with (folder / 'runs.csv').open('ab') as stream:
        stream.write(b'simulated,noise,0.0,1,dn' + b'\0' * 200_000 + b'\rabc\n')
    assert not ResultStore(folder).missing(tasks)


def test_a_run_written_twice_counts_once(half_done):
    folder, tasks = half_done
    lines = (folder / 'runs.csv').read_text().splitlines(keepends=True)
    (folder / 'runs.csv').write_text(''.join(lines + lines[1:9]))
    assert len(ResultStore(folder).select(tasks)) == len(lines) - 1
    assert (folder / 'runs.csv').read_text() == ''.join(lines)


def test_a_solver_more_needs_only_its_own_time(half_done):
    folder, _ = half_done
    more = simulated_tasks(1, 0, (*QUICK, 'zhuang'))
    missing = ResultStore(folder).missing(more)
    assert [task.solvers for task in missing[:2]] == [('zhuang',)] * 2
    assert missing[2].solvers == (*QUICK, 'zhuang')


def test_results_of_other_settings_are_not_mixed(half_done):
    folder, _ = half_done
    (folder / 'settings.json').write_text('{"version": "0.0.1"}')
    with pytest.raises(ResultError, match='another --output'):
        ResultStore(folder)


def test_a_folder_that_cannot_be_used(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(ResultError, match='another --output'):
        ResultStore(tmp_path / 'file')


# --- The whole command ---

def test_an_interrupted_run_continues(tmp_path, monkeypatch):
    monkeypatch.setattr('benchmarks.paper.figures.draw_all', lambda *_: [])
    benchmark = PaperBenchmark(tmp_path, runs=1, solvers=QUICK, executor=Executor(processes=1))

    def interrupt(done, _):
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_paper(benchmark, interrupt)
    before = rows_of(tmp_path / 'runs.csv')
    assert len(before) == 7 * len(QUICK) * len(REFERENCES)
    seen = []
    summary = run_paper(benchmark, lambda done, total: seen.append((done, total)))
    assert seen == [(done, 19) for done in range(8, 20)]
    after = rows_of(tmp_path / 'runs.csv')
    assert after[:len(before)] == before
    assert len(after) == 19 * len(QUICK) * len(REFERENCES)
    assert '12 of 19 runs computed in this call' in summary.read_text(encoding='utf-8')


def test_a_summary_that_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr('benchmarks.paper.figures.draw_all', lambda *_: [])
    (tmp_path / 'summary.md').mkdir()
    benchmark = PaperBenchmark(tmp_path, runs=1, solvers=('park',), executor=Executor(processes=1))
    with pytest.raises(ResultError, match=r'summary.md cannot be written: Is a directory'):
        run_paper(benchmark, lambda *_: None)


def run_main(capsys, *arguments):
    """Run ``python -m benchmarks.paper``; return its status and what it printed."""
    status = main(list(map(str, arguments)))
    return status, *capsys.readouterr()


def test_the_command_writes_tables_and_figures(tmp_path, capsys):
    command = ('--runs', '2', '--seed', '5', '--solvers', 'park,dnlo', '--processes', '1',
               '--output', tmp_path)
    status, out, err = run_main(capsys, *command)
    assert (status, err) == (0, '')
    assert out == f'{tmp_path / "summary.md"}\n'
    text = (tmp_path / 'summary.md').read_text(encoding='utf-8')
    assert 'simulator seeds 5 to 6' in text
    assert '| Under outliers B1 is best |' in text
    for name in ('motions', 'best', 'dnlo', 'mixture'):
        assert f'(figures/simulated_{name}.png)' in text
        png = (tmp_path / 'figures' / f'simulated_{name}.png').read_bytes()
        assert png.startswith(b'\x89PNG')
        ET.parse(tmp_path / 'figures' / f'simulated_{name}.svg')
    summary = rows_of(tmp_path / 'summary.csv')
    assert len(summary) == 19 * 2 * len(REFERENCES) * len(ERRORS)
    assert {row['runs'] for row in summary} == {'2'}
    assert len(rows_of(tmp_path / 'motions.csv')) == len(REFERENCES)
    # Again, with nothing left to compute, the same figures come out.
    before = {path: path.read_bytes() for path in (tmp_path / 'figures').iterdir()}
    assert run_main(capsys, *command)[0] == 0
    assert before == {path: path.read_bytes() for path in (tmp_path / 'figures').iterdir()}


@pytest.mark.parametrize(('options', 'message'), [
    (('--runs', '0'), 'at least one'),
    (('--seed', '-1'), 'seed of 0 or more'),
    (('--solvers', 'dnl,magic'), 'magic'),
    (('--trajectories', 'published'), '--data'),
    (('--trajectories', 'mars'), 'mars'),
    (('--backend', 'cloud'), 'cloud'),
    (('--processes', '-1'), 'processes is -1'),
    (('--scheduler', 'tcp://nowhere:1'), 'backend is not dask'),
])
def test_wrong_use(capsys, tmp_path, options, message):
    status, _, err = run_main(capsys, '--output', tmp_path / 'out', *options)
    assert status == 2
    assert message in err
    assert err.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_a_folder_without_published_data(capsys, tmp_path):
    status, _, err = run_main(
        capsys, '--output', tmp_path / 'out', '--data', tmp_path)
    assert status == 1
    assert 'needed the folder of the published data' in err


# --- The executor ---

def double(item):
    return 2 * item


def test_results_come_in_the_order_of_the_items():
    assert list(in_order(Executor(processes=2), double, range(40))) == list(range(0, 80, 2))
    assert list(in_order(Executor(processes=1), double, [])) == []


def test_dask_gives_what_joblib_gives():
    distributed = pytest.importorskip('distributed', reason='distributed is not installed')
    tasks = simulated_tasks(1, 0, ('park',))[:4]
    # A cluster that is there already; test_cli_fleet.py has one that is started.
    with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        executors = Executor('dask', scheduler=cluster.scheduler_address), Executor(processes=1)
        found, expected = (
            [[record.errors for record in result.records]
             for result in in_order(one, run_task, tasks)]
            for one in executors)
    assert found == expected


@pytest.mark.parametrize(('module', 'executor'), [
    ('joblib', Executor()), ('distributed', Executor('dask'))])
def test_what_is_not_installed_is_named(monkeypatch, module, executor):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingPackageError,
                       match=f'^{module} is not installed; pip install {module}$'):
        list(in_order(executor, double, [1]))


def test_joblib_of_ubuntu_which_knows_one_order_serves_on_one_machine(monkeypatch):
    joblib = pytest.importorskip('joblib')
    new = joblib.Parallel

    def old(return_as):
        if return_as == 'generator_unordered':
            raise ValueError(return_as)
        return new(return_as=return_as)

    monkeypatch.setattr(joblib, 'Parallel', old)
    assert sorted(Executor(processes=2).unordered(double, [3, 4])) == [(0, 6), (1, 8)]
    monkeypatch.setattr(Executor, '_cluster', nullcontext)
    monkeypatch.setattr(joblib, 'parallel_config', lambda **_: nullcontext())
    with pytest.raises(ConfigError, match=r'dask needs joblib 1\.4'):
        list(Executor('dask').unordered(double, [3, 4]))


# --- Averages and conclusions ---

def test_interval_of_the_mean():
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    low, high = mean_interval(values)
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.15 * half)


def groups_of(e_at):
    """Return groups with the median e_at(kind, solver, reference) in three runs, e_rt its own."""
    groups = {}
    for kind, level in HARDEST.items():
        for solver in PAPER_SOLVERS:
            for reference in REFERENCES:
                e_rt = 0.01 if reference == 'B1' else 0.02
                error = e_at(kind, solver, reference)
                groups[Cell('simulated', kind, level, solver, reference)] = np.outer(
                    [0.9, 1.0, 1.1], [e_rt, error, error, error])
    return groups


def as_the_paper_says(kind, solver, reference):
    order = {'noise': ['B10', 'C10', 'B5', 'C5', 'B1', 'A'],
             'outliers': ['B1', 'C5', 'B5', 'C10', 'B10', 'A'],
             'drift': ['B1', 'C5', 'B5', 'C10', 'B10', 'A'],
             'mixture': ['B5', 'C5', 'C10', 'B10', 'B1', 'A']}[kind]
    return 0.01 * 2**order.index(reference) * (0.7 if solver == 'dnlo' else 1.0)


def verdicts(e_at):
    return [claim.verdict for claim in judge(groups_of(e_at), 'simulated', PAPER_SOLVERS)]


def test_every_claim_holds_where_it_does():
    assert verdicts(as_the_paper_says) == [HOLDS] * 7


def test_every_claim_fails_where_it_does():
    def reverse(kind, solver, reference):
        return 1e-4 / as_the_paper_says(kind, 'dnl', reference) * (30 if solver == 'dnlo' else 1)
    assert verdicts(reverse)[:4] == [FAILS] * 4
    assert verdicts(reverse)[6] == FAILS
    # All references alike, and B1 best in both errors.
    alike = verdicts(lambda _, solver, reference:
                     PAPER_SOLVERS.index(solver) + (1.0 if reference == 'B1' else 1.01))
    assert alike[4] == FAILS
    assert alike[5] == FAILS


def test_a_claim_that_one_solver_contradicts_holds_in_part():
    def one_differs(kind, solver, reference):
        if solver == 'ali' and reference == 'C5':
            return 1e-3
        return as_the_paper_says(kind, solver, reference)
    assert verdicts(one_differs)[2:4] == [PARTLY, PARTLY]


def test_claims_need_their_runs():
    assert {claim.verdict for claim in judge({}, 'simulated', PAPER_SOLVERS)} == {OPEN}
    assert {claim.verdict for claim in judge(
        groups_of(as_the_paper_says), 'simulated', ('drift_aware',))} == {OPEN}


def claims_without(lost):
    """Judge groups as the paper says, but for cells without an answer."""
    groups = groups_of(as_the_paper_says)
    for cell in filter(lost, groups):
        groups[cell][:] = np.nan
    return judge(groups, 'simulated', PAPER_SOLVERS)


def test_a_solver_without_an_answer_has_no_part_in_a_claim():
    claims = claims_without(lambda cell: cell.solver == 'ali')
    assert [claim.verdict for claim in claims] == [HOLDS] * 7
    assert all(claim.evidence.endswith('; without all of the answers: ali') for claim in claims)
    assert claims[2].evidence.startswith('5 of 5 solvers')


def test_a_solver_has_its_part_in_claims_whose_answers_it_has():
    lost = {('ali', 'A', 'mixture'), ('park', 'B1', 'drift'), ('zhuang', 'B1', 'mixture')}
    claims = claims_without(lambda cell: (cell.solver, cell.reference, cell.kind) in lost)
    assert [claim.verdict for claim in claims] == [HOLDS] * 7
    assert [claim.evidence.partition('answers: ')[2] for claim in claims] == [
        '', 'ali, park, zhuang', '', 'zhuang', 'zhuang', 'ali, park, zhuang', '']
    # Five solvers at six references, one of them at five.
    assert 'over all 29 combinations' in claims[4].evidence


def test_a_claim_without_solvers_is_not_judged():
    claims = claims_without(lambda cell: cell.reference == 'A')
    assert [k for k, claim in enumerate(claims) if claim.verdict == OPEN] == [1, 5]
    # DNLO is compared with nobody.
    assert claims_without(lambda cell: cell.solver != 'dnlo')[6].verdict == OPEN


def test_differences_from_published_runs_are_counted():
    def record(reference, e_at):
        return Record('published', 'noise', 0.01, 2, 'dnl', reference, 0.1, 0.1, e_at, 1.0, 1.0)
    published = {('noise', 0.01, 2, 'dnl', reference): np.array([0.1, 0.1, 0.5, 1.0])
                 for reference in REFERENCES}
    rows = compare_runs(
        [record('B1', 0.5001), record('B5', 0.49), record('B10', 0.51)], published)
    assert [(row.reference, row.agree, row.lower, row.higher) for row in rows] == [
        ('B1', 1, 0, 0), ('B5', 0, 1, 0), ('B10', 0, 0, 1)]
