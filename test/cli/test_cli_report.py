# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The screen, the exit status and the report of the command line."""

import hashlib
from html.parser import HTMLParser
import json
import os
from pathlib import Path
import subprocess
import sys

from cli_helpers import run, write_pair
import numpy as np
import pytest

from trajectory_calibration import CalibrationResult

SOLVER = ('--solver', 'ali', '--reference', 'B5', '--allow-unobserved')


@pytest.fixture
def planar(tmp_path):
    return write_pair(tmp_path, planar=True)[:2]


def test_an_open_direction_is_unknown_in_every_surface_and_status_3(planar, tmp_path, capsys):
    page = tmp_path / 'out/page.html'
    status, out, err = run(
        capsys, 'calibrate', *planar, *SOLVER, '--report', page, '--output', tmp_path / 'out')
    assert (status, err) == (3, '')
    row = next(line.split() for line in out.splitlines() if line.startswith('  z '))
    assert row == ['z', 'unknown', 'unknown']
    assert f'wrote {page}' in out
    text = page.read_text(encoding='utf-8')
    assert '<td class="num value">unknown</td>' in text
    assert 'Incomplete' in text
    status, out, err = run(capsys, 'calibrate', *planar, *SOLVER, '-q')
    assert (status, out.split()[2]) == (3, 'unknown')
    assert any(line.startswith('serious: translation along z of sensor_a unobservable')
               for line in err.splitlines())
    status, out, _ = run(capsys, 'calibrate', *planar, *SOLVER, '--format', 'json')
    assert status == 3
    assert json.loads(out)['observability']['status']['z'] == 'unobserved'
    assert np.isfinite(json.loads(out)['T_a_b']['translation']).all()


def test_files_are_overwritten_only_by_force(tmp_path, capsys):
    a, b, truth = write_pair(tmp_path)
    options = ['calibrate', a, b, '--solver', 'taylor', '--reference', 'B5', '--output',
               tmp_path / 'out', '--report', tmp_path / 'page.html']
    assert run(capsys, *options)[0] == 0
    before = (tmp_path / 'page.html').stat().st_mtime_ns
    status, out, err = run(capsys, *options)
    assert (status, out) == (2, '')
    assert 'exist; give --force to overwrite' in err
    assert (tmp_path / 'page.html').stat().st_mtime_ns == before
    assert run(capsys, *options, '--force')[0] == 0
    saved = tmp_path / 'out/result.yaml'
    status, out, _ = run(capsys, 'report', saved, a, b, '--ground-truth', truth)
    assert (status, out) == (0, f'wrote {tmp_path / "out/result.html"}\n')
    text = (tmp_path / 'out/result.html').read_text(encoding='utf-8')
    assert CalibrationResult.load(saved).frame_a in text
    assert run(capsys, 'report', saved, a, b)[0] == 2
    # Other trajectories are no evidence for this result, and the page says so first.
    status, _, err = run(capsys, 'report', saved, b, a, '--output', tmp_path / 'other.html')
    assert 'serious: A and B are not the trajectories of ' in err
    text = (tmp_path / 'other.html').read_text(encoding='utf-8')
    assert 'Usable with care' in text
    assert '<code>recording-other</code>' in text


def test_the_report_holds_the_inputs_and_a_command_that_repeats_it(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path)
    page = tmp_path / 'page.html'
    run(capsys, 'calibrate', a, b, '--solver', 'taylor', '--reference', 'B5', '--report', page)
    text = page.read_text(encoding='utf-8')
    assert f'trajectory_calibration calibrate {a} {b} --solver taylor' in text
    for name in (a, b):
        assert hashlib.sha256(Path(name).read_bytes()).hexdigest() in text


@pytest.mark.parametrize('change', [('--time-offset', '100'), ('--reference', 'B79')])
def test_a_failed_calibration_has_a_report(tmp_path, capsys, change):
    a, b, _ = write_pair(tmp_path)
    page = tmp_path / 'page.html'
    status, out, err = run(capsys, 'calibrate', a, b, '--solver', 'taylor', *change,
                           '--report', page)
    assert (status, out) == (1, '')
    assert err.startswith(f'wrote {page}\nerror: ')
    text = page.read_text(encoding='utf-8')
    HTMLParser().feed(text)
    reason = err.splitlines()[1][len('error: '):].partition(';')[0][10:40]
    assert reason in text
    assert 'No answer' in text
    assert '80 poses over 7.9 s' in text


def test_input_that_cannot_be_read_has_a_report(tmp_path, capsys):
    a, _, _ = write_pair(tmp_path)
    page = tmp_path / 'page.html'
    status, _, _ = run(capsys, 'calibrate', a, tmp_path / 'none.txt', '--report', page)
    assert status == 1
    assert 'none.txt' in page.read_text(encoding='utf-8')


def test_a_path_that_is_no_utf_8_has_a_report(tmp_path, capsys):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b'/M\xfcller'))
    folder.mkdir()
    a, b, _ = write_pair(folder)
    assert run(capsys, 'calibrate', a, b, *SOLVER, '--report', folder / 'page.html')[0] == 0
    assert r'M\udcfcller/a.txt' in (folder / 'page.html').read_text(encoding='utf-8')


def test_plots_are_written_in_three_formats(tmp_path, capsys, monkeypatch):
    pytest.importorskip('matplotlib')
    from trajectory_calibration.outputs import plots
    # One of the figures, for the time that it takes; test_report draws another.
    monkeypatch.setattr(plots, '_FIGURES', {'parts': plots._FIGURES['parts']})
    a, b, _ = write_pair(tmp_path)
    folder = tmp_path / 'plots'
    assert run(capsys, 'calibrate', a, b, '--solver', 'taylor', '--reference', 'B5',
               '--plots', folder)[0] == 0
    assert {path.suffix for path in folder.iterdir()} == {'.png', '.svg', '.pdf'}
    assert (folder / 'parts.png').read_bytes().startswith(b'\x89PNG')


def test_a_shell_completes_commands_and_options():
    pytest.importorskip('argcomplete')

    def completed(line):
        environment = {
            **os.environ, '_ARGCOMPLETE': '1', '_ARGCOMPLETE_IFS': '\n', 'COMP_LINE': line,
            'COMP_POINT': str(len(line)), 'COMP_TYPE': '9', '_ARGCOMPLETE_STDOUT_FILENAME': '',
            'ARGCOMPLETE_USE_TEMPFILES': '1'}
        read, write = os.pipe()
        code = (f'import os; os.dup2({write}, 8)\n'
                'from trajectory_calibration.cli.main import main; main([])')
        del environment['_ARGCOMPLETE_STDOUT_FILENAME'], environment['ARGCOMPLETE_USE_TEMPFILES']
        subprocess.run([sys.executable, '-c', code], env=environment, pass_fds=(write,),
                       check=False, timeout=60)
        os.close(write)
        with os.fdopen(read) as stream:
            return {word.strip() for word in stream.read().split('\n')}

    assert 'calibrate' in completed('trajectory_calibration cal')
    assert '--report' in completed('trajectory_calibration calibrate --rep')
