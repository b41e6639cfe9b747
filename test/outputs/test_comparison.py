# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many answers: one truth, or a change that is named; never a mean over two."""

import csv
import dataclasses
from html.parser import HTMLParser
import io
import json

from motion_data import perturb, random_pose, sensor_pair
import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, ResultError
from trajectory_calibration.assessment.observability import Observability
from trajectory_calibration.fleet.comparison import COLUMNS, compare, Entry, short_names, span_of
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.comparison_table import to_csv, to_json, to_text
from trajectory_calibration.outputs.fleet_page import fleet_page
from trajectory_calibration.outputs.screen import format_result

DAY_NS = 86_400 * 10**9
MOVED = np.array([0.08, 0, 0, 0, 0, np.deg2rad(1.5)])


@pytest.fixture(scope='module')
def result():
    rng = np.random.default_rng(0)
    a, b = (perturb(rng, item, 2e-3, 1e-3) for item in sensor_pair(rng, random_pose(rng)))
    return calibrate(a, b, CalibrationConfig(solver='park'))


def fleet(result, count, step_of=None, seed=0, covariance=None, errors=1.0):
    """Return answers of one truth with steps ``step_of`` and errors of their covariances."""
    rng = np.random.default_rng(seed)
    P = np.diag([4e-6, 4e-6, 1e-5, 1e-6, 1e-6, 2e-6]) if covariance is None else covariance
    entries = []
    for k in range(count):
        error = errors * rng.multivariate_normal(np.zeros(6), P)
        step = np.zeros(6) if step_of is None else step_of(k)
        T = se3.moved(se3.moved(result.T_a_b, step), error)
        entries.append(Entry(f'fleet{k}', dataclasses.replace(
            result, T_a_b=T, covariance=P, start_ns=result.start_ns + k * DAY_NS,
            recording=str(k))))
    return entries


def test_a_change_is_named_with_its_size(result):
    found = compare(fleet(result, 12, lambda k: MOVED * (k >= 8)))
    assert found.exit_status == 4
    (line,) = found.describe()
    assert line.startswith('CHANGED: fleet0-7 | fleet8-11: +0.08')
    assert ' m along x, +1.' in line
    assert 'deg about z' in line
    assert [len(item.names) for item in found.stretches] == [8, 4]
    np.testing.assert_allclose(found.changes[0].step, MOVED, atol=6e-3)
    for item, T in zip(found.stretches, (
            result.T_a_b, se3.moved(result.T_a_b, MOVED)), strict=True):
        error = se3.step_between(T, item.T_a_b)
        assert error @ np.linalg.solve(item.covariance, error) < 25


@pytest.mark.statistical
@pytest.mark.parametrize('count', [2, 3, 12, 30])
def test_unchanged_answers_agree(result, count):
    alarms = sum(compare(fleet(result, count, seed=seed)).exit_status > 0 for seed in range(60))
    assert alarms <= 3


def test_the_date_makes_the_order_and_names_break_ties(result):
    entries = fleet(result, 12, lambda k: MOVED * (k >= 8))
    assert compare(entries[::-1]).describe() == compare(entries).describe()
    undated = [Entry(item.name, dataclasses.replace(item.result, start_ns=None))
               for item in entries]
    assert compare(undated).describe() == compare(entries).describe()


def test_a_clock_that_was_not_set_puts_no_recording_before_the_others(result):
    entries = fleet(result, 8, lambda k: MOVED * (k >= 4))
    for k in (2, 6):
        entries[k] = Entry(
            entries[k].name, dataclasses.replace(entries[k].result, start_ns=10**13))
    found = compare(entries)
    assert [entry.name for entry in found.entries] == [f'fleet{k}' for k in range(8)]
    assert found.spans == [('fleet0-3', 'fleet4-7')]
    assert any(line.startswith('2 of 8 without a date ') for line in found.describe())


def test_a_recording_that_is_given_twice_counts_once(result):
    entries = fleet(result, 3)
    again = Entry('copy', dataclasses.replace(
        entries[0].result, start_ns=entries[2].result.start_ns, config=CalibrationConfig()))
    found = compare([*entries, again])
    alone = compare(entries)
    assert (found.chi_squared, found.degrees_of_freedom) == (
        alone.chi_squared, alone.degrees_of_freedom)
    assert found.describe() == [
        *alone.describe(), 'copy: same recording as fleet0, counted once']
    assert [line.split()[:2] for line in to_text(found).splitlines()][-3] == ['copy', 'repeated']
    assert 'same recording as fleet0' in fleet_page(found)
    with pytest.raises(ResultError, match='to compare; again: same recording as fleet0'):
        compare([entries[0], Entry('again', entries[0].result)])
    # Results of older versions have no checksum of the recording.
    unknown = [Entry(item.name, dataclasses.replace(item.result, recording=None))
               for item in (entries[0], entries[0])]
    assert compare(unknown).describe() == ['AGREE: 2 answers are of one extrinsic (chi2/dof 0)']


def test_one_odd_answer_and_two_changes_are_found(result):
    odd = compare(fleet(result, 9, lambda k: MOVED * (k == 4)))
    assert [item.names for item in odd.stretches][1] == ('fleet4',)
    twice = compare(fleet(result, 15, lambda k: MOVED * (k >= 5) + MOVED * (k >= 10)))
    assert [len(item.names) for item in twice.stretches] == [5, 5, 5]


def test_two_vehicles_in_turn_have_no_mean(result):
    found = compare(fleet(result, 12, lambda k: MOVED * (k % 2)))
    assert found.exit_status == 4
    assert not found.stretches
    assert found.describe()[0].startswith('CONTRADICTION: the 12 answers scatter')
    assert 'No mean is formed' in found.describe()[0]
    assert json.loads(to_json(found))['stretches'] == []
    assert 'CONTRADICTION' in fleet_page(found)


def test_a_row_of_the_table_reads_as_the_screen_of_its_result(result):
    # Roll, pitch and yaw of an optical frame turn about other axes than x, y, z of the parent.
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ result.T_a_b[:3, :3].T
    turned = dataclasses.replace(result, T_a_b=se3.from_rotation_translation(
        R @ result.T_a_b[:3, :3], result.T_a_b[:3, 3]))
    P = np.diag([4e-6, 4e-6, 1e-5, 1e-6, 9e-6, 8e-5])
    entries = fleet(turned, 2, covariance=P)
    table = to_text(compare(entries)).splitlines()
    for entry in entries:
        (row,) = [line for line in table if line.startswith(entry.name)]
        screen = [line.split() for line in format_result(entry.result).splitlines()[1:7]]
        assert ' '.join(row.split()[3:21]) == ' '.join(
            ' '.join(words[1:4]) for words in screen)


@pytest.mark.statistical
def test_errors_a_little_larger_than_stated_are_no_change(result):
    alarms = 0
    for seed in range(20):
        found = compare(fleet(result, 20, seed=seed, errors=1.6))
        alarms += found.exit_status > 0
    assert alarms <= 2
    assert found.noise_ratio > 1.2


def test_what_no_answer_knows_is_left_out(result):
    status = {**dict.fromkeys(result.observability.status, 'observed'), 'z': 'unobserved'}
    blind = dataclasses.replace(result, observability=Observability(
        status, (), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), ((1.0, 0.0, 0.0),) * 3))
    P = np.diag([4e-6, 4e-6, 100.0, 1e-6, 1e-6, 2e-6])
    found = compare(fleet(blind, 12, covariance=P))
    assert found.exit_status == 0
    assert 'unknown' in to_text(found)
    assert 'unknown in every recording' in fleet_page(found)
    for row in csv.DictReader(io.StringIO(to_csv(found))):
        assert (row['z_m'], row['unobserved']) == ('', 'z')
        assert row['x_m'] and row['roll_deg']
    found = compare(fleet(blind, 12, lambda k: MOVED * (k >= 8), covariance=P))
    assert found.describe()[0].startswith('CHANGED: fleet0-7 | fleet8-11')


class Structure(HTMLParser):
    """Counts tags and checks that they close."""

    VOID = frozenset(('meta', 'line', 'rect', 'circle'))

    def __init__(self, text):
        super().__init__()
        self.open, self.count = [], {}
        self.feed(text)

    def handle_starttag(self, tag, _attributes):
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_table_json_and_page_say_the_same(result):
    entries = [*fleet(result, 12, lambda k: MOVED * (k >= 8)),
               Entry('<broken>', None, 'a & b: the "bag" is empty')]
    found = compare(entries)
    text = to_text(found)
    assert text.startswith('CHANGED: fleet0-7 | fleet8-11')
    assert '1 of 13 gave no answer' in text
    assert '<broken>  no answer' in text
    rows = list(csv.DictReader(io.StringIO(to_csv(found))))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 13
    data = json.loads(to_json(found))
    assert data['exit_status'] == 4
    assert data['changes'][0]['before'] == 'fleet0-7'
    for one, other, entry in zip(rows, data['rows'], entries, strict=True):
        assert one['name'] == other['name'] == entry.name
        if entry.result is not None:
            assert float(one['x_m']) == pytest.approx(other['x_m'], rel=1e-8)
            assert other['x_m'] == entry.result.T_a_b[0, 3]
    page = fleet_page(found)
    structure = Structure(page)
    assert not structure.open
    assert structure.count['svg'] == structure.count['figure'] == 6
    assert structure.count['circle'] == 6 * 12
    assert structure.count['tr'] == 14
    assert page.count('class="change"') == 6
    assert '<broken>' not in page
    assert 'a &amp; b' in page
    assert 'script' not in structure.count
    for elsewhere in ('http:', 'https:', 'src=', '@import'):
        assert elsewhere not in page
    assert len(page) < 60_000


def test_answers_that_cannot_be_compared_are_refused(result):
    one = Entry('one', result)
    with pytest.raises(ResultError, match='1 answer, needed at least 2'):
        compare([one, Entry('two', None, 'no motion')])
    other = Entry('two', dataclasses.replace(result, frame_b='thermal'))
    with pytest.raises(ResultError, match='camera in lidar; thermal in lidar'):
        compare([one, other])
    with pytest.raises(ResultError, match='no covariance'):
        compare([one, Entry('two', dataclasses.replace(
            result, covariance=None, recording='other'))])


def test_names_in_short():
    assert span_of(['fleet0', 'fleet1', 'fleet7']) == 'fleet0-7'
    assert span_of(['a']) == 'a'
    assert span_of(['day09', 'day10']) == 'day09-10'
    assert span_of(['day3', 'day1', 'day4']) == 'day3 ... day4'
    assert span_of(['mon', 'tue']) == 'mon, tue'
    assert span_of(['mon', 'tue', 'wed']) == 'mon ... wed'
    assert short_names(['x/mon.mcap', 'x/tue.mcap']) == ['mon', 'tue']
    assert short_names(['mon/result.yaml', 'tue/result.yaml']) == ['mon', 'tue']
    assert short_names(['a/b/r.yaml', 'c/b/r.yaml']) == ['a/b/r', 'c/b/r']
