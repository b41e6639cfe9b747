# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command line as a process: start-up, signals, pipes, progress."""

import io
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from cli_helpers import run, write_pair, write_pair_bag
import pytest

from trajectory_calibration import __version__
from trajectory_calibration.cli import progress
from trajectory_calibration.cli.main import main
from trajectory_calibration.errors import SolverError

COMMAND = (sys.executable, '-m', 'trajectory_calibration')
# Pipes, signals and terminals are those of Python, whatever it has loaded.
OF_PIPES = pytest.mark.once


def test_module_runs_as_a_process(tmp_path):
    a, b, truth = write_pair(tmp_path)
    done = subprocess.run(
        [*COMMAND, 'calibrate', a, b, '--solver', 'taylor', '--format', 'json',
         '--ground-truth', truth],
        capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, '')
    assert json.loads(done.stdout)['e_at_m'] < 1e-9


def test_failure_as_a_process(tmp_path):
    done = subprocess.run(
        [*COMMAND, 'inspect', str(tmp_path / 'none')],
        capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stdout == ''
    assert done.stderr.startswith('error: ')
    assert done.stderr.count('\n') == 1


@pytest.fixture
def interruptible():
    """Where a shell runs the tests in the background, children would ignore the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@OF_PIPES
@pytest.mark.usefixtures('interruptible')
def test_interrupt_is_quiet(tmp_path):
    fifo = tmp_path / 'a.txt'
    os.mkfifo(fifo)
    with subprocess.Popen(
            [*COMMAND, 'inspect', str(fifo)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:
        # Opening for writing returns when the process has opened the other end.
        with fifo.open('wb'):
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=120)
        assert (process.returncode, out, err) == (130, b'', b'')


@OF_PIPES
def test_a_reader_that_leaves_is_no_error(tmp_path):
    a, _, _ = write_pair(tmp_path)
    with subprocess.Popen(
            [*COMMAND, 'inspect', a], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        err = process.stderr.read()
        assert (process.wait(timeout=120), err) == (0, b'')


def _shell(command, **environment):
    """Run a line of shell in which $CLI is the command line."""
    return subprocess.run(
        ['bash', '-c', command.replace('$CLI', f'{sys.executable} -m trajectory_calibration')],
        env={**os.environ, **environment}, capture_output=True, check=False, timeout=60)


@OF_PIPES
@pytest.mark.skipif(not Path('/dev/full').exists(), reason='no /dev/full on this system')
@pytest.mark.parametrize('command', ['inspect {a}', '--help', 'calibrate {a} {b} --solver park'])
def test_a_full_disk_is_one_line(tmp_path, command):
    a, b, _ = write_pair(tmp_path)
    done = _shell(f'$CLI {command.format(a=a, b=b)} > /dev/full')
    assert done.returncode == 1
    assert done.stderr == (
        b'error: standard output cannot be written: No space left on device; free space, or '
        b'write elsewhere\n')


@OF_PIPES
@pytest.mark.parametrize('command', [
    'inspect {a} >&-', '--version >&-', '--help >&-', 'inspect {a} 2>&-',
    'fleet {f}/x {f}/y --a a.txt --b b.txt --output {f}/out >&-'])
def test_a_closed_output_is_no_error(tmp_path, command):
    a, _, _ = write_pair(tmp_path)
    for name, count in (('x', 80), ('y', 90)):
        (tmp_path / name).mkdir()
        write_pair(tmp_path / name, count=count)
    done = _shell(f'$CLI {command.format(a=a, f=tmp_path)}')
    assert done.returncode == 0
    assert b'Traceback' not in done.stderr


@OF_PIPES
def test_a_closed_output_leaves_the_errors(tmp_path):
    done = _shell(f'$CLI inspect {tmp_path}/none >&-')
    assert (done.returncode, done.stderr.count(b'\n')) == (1, 1)
    assert done.stderr.startswith(b'error: ')


def test_a_path_that_the_system_refuses_is_one_line(capsys):
    status, out, err = run(capsys, 'inspect', 'x' * 5000)
    assert (status, out) == (1, '')
    assert err == f'error: {"x" * 5000}: File name too long\n'


@OF_PIPES
@pytest.mark.parametrize('command', [
    'calibrate {a} {b} --solver park --frame-a ä', 'fleet --help', '--help'])
def test_characters_that_the_terminal_lacks_are_escaped(tmp_path, command):
    a, b, _ = write_pair(tmp_path)
    done = _shell(f'$CLI {command.format(a=a, b=b)}', PYTHONIOENCODING='ascii')
    assert (done.returncode, done.stderr) == (0, b'')
    assert ('ä' in command) == (rb'sensor_b in \xe4' in done.stdout)


@pytest.mark.parametrize('module, package, command', [
    ('casadi', 'casadi', 'calibrate {a} {b} --solver dnl --reference B5'),
    ('ruamel', 'ruamel.yaml', 'calibrate {a} {b} --config {a}'),
    ('ruamel.yaml', 'ruamel.yaml', 'calibrate {a} {b} --solver park --format yaml')])
def test_a_package_that_is_missing_is_named(tmp_path, module, package, command):
    a, b, _ = write_pair(tmp_path)
    done = _run_without(module, *command.format(a=a, b=b).split())
    assert (done.returncode, done.stdout) == (1, '')
    assert done.stderr == f'error: {package} is not installed; pip install {package}\n'


def _run_without(module, *arguments):
    """Run the command line where a module cannot be imported."""
    code = (
        'import sys\n'
        f'sys.modules["{module}"] = None\n'
        'from trajectory_calibration.cli.main import main\n'
        'sys.exit(main(sys.argv[1:]))\n')
    return subprocess.run(
        [sys.executable, '-c', code, *arguments],
        capture_output=True, text=True, check=False, timeout=60)


def test_start_loads_nothing_heavy():
    code = (
        'import sys\n'
        'from trajectory_calibration.cli.main import main\n'
        'main(["--version"])\n'
        'heavy = {"casadi", "scipy", "rosbags", "rclpy", "matplotlib", "ruamel.yaml"}\n'
        'print(sorted(heavy & set(sys.modules)))\n')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == f'trajectory_calibration {__version__}\n[]\n'


def test_an_answer_loads_nothing_that_it_does_not_need(tmp_path):
    """Each of these takes as long to import as a calibration of 1,000 poses."""
    a, b, _ = write_pair(tmp_path)
    code = (
        'import sys\n'
        # NumPy 1.23 loads some of them itself.
        'import numpy\n'
        'before = set(sys.modules)\n'
        'from trajectory_calibration.cli.main import main\n'
        'main(sys.argv[1:])\n'
        'slow = {"scipy", "casadi", "rosbags", "ruamel.yaml", "importlib.metadata",\n'
        '        "urllib.request", "multiprocessing", "xml.etree.ElementTree", "secrets",\n'
        '        "decimal", "trajectory_calibration.rig.calibration",\n'
        '        "trajectory_calibration.cli.fleet"}\n'
        'print(sorted(slow & set(sys.modules) - before), file=sys.stderr)\n')
    done = subprocess.run([sys.executable, '-c', code, 'calibrate', a, b],
                          capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.startswith('Pose of sensor_b in sensor_a')
    assert done.stderr == '[]\n'


def test_files_and_bags_are_read_and_calibrated_with_numpy_alone(tmp_path):
    a, b, _ = write_pair(tmp_path)
    bag = str(write_pair_bag(tmp_path / 'bag'))
    commands = [['inspect', a], ['inspect', bag], ['calibrate', a, b],
                ['simulate', '--output', str(tmp_path / 'drive'), '--force']]
    modules = ['rosbags', 'apsw', 'scipy', 'casadi', 'ruamel', 'ruamel.yaml']
    # One process that has loaded none of them, and a copy of it without each.
    code = (
        'import os, sys\n'
        'from trajectory_calibration.cli.main import main\n'
        f'for module in {modules}:\n'
        # An empty namespace may be there from the start.
        '    assert not [name for name in sys.modules if name.startswith(module + ".")]\n'
        '    child = os.fork()\n'
        '    if not child:\n'
        '        sys.modules[module] = None\n'
        f'        found = [main(command) for command in {commands}]\n'
        '        sys.stdout.flush()\n'
        '        os._exit(any(found))\n'
        '    status = os.waitpid(child, 0)[1]\n'
        # What is not flushed, the next copy would write again.
        '    print("without", module, status, flush=True)\n')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, '')
    assert re.findall(r'^without (\S+) (\d+)$', done.stdout, re.MULTILINE) == [
        (module, '0') for module in modules]


@pytest.mark.parametrize('arguments', [[], ['nonsense'], ['--nonsense'], ['calibrate', '--x']])
def test_wrong_usage(capsys, arguments):
    assert run(capsys, *arguments)[0] == 2


@pytest.mark.parametrize('arguments', [
    [], ['calibrate'], ['export'], ['replay'], ['report'], ['simulate'], ['fleet']])
def test_help_fits_a_terminal(monkeypatch, capsys, arguments):
    monkeypatch.setenv('COLUMNS', '80')
    status, out, err = run(capsys, *arguments, '--help')
    assert (status, err) == (0, '')
    assert out.startswith('usage: trajectory_calibration')
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize('arguments', [
    [], ['calibrate'], ['export'], ['replay'], ['simulate'], ['fleet']])
def test_wrong_usage_is_two_lines(monkeypatch, capsys, arguments):
    monkeypatch.setenv('COLUMNS', '80')
    status, out, err = run(capsys, *arguments)
    assert (status, out, err.count('\n')) == (2, '', 2)
    assert err.startswith('usage: trajectory_calibration')


def test_version(capsys):
    assert run(capsys, '--version') == (0, f'trajectory_calibration {__version__}\n', '')


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_on_a_terminal_is_drawn_and_cleared(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr(sys, 'stderr', terminal)
    monkeypatch.setattr(progress, '_DELAY_S', 0.0)
    monkeypatch.setattr(progress, '_UPDATE_S', 0.001)
    with progress.progress('reading') as draw:
        for done, bar in ((1, '[########......................]  25%'), (4, '100%')):
            draw(done, 4)
            while bar not in terminal.getvalue():
                time.sleep(0.001)
    assert terminal.getvalue().endswith(f'\rreading [{"#" * 30}] 100%\r\033[K')


def test_short_work_and_files_see_no_progress(monkeypatch):
    terminal, file = _Terminal(), io.StringIO()
    monkeypatch.setattr(sys, 'stderr', terminal)
    with progress.progress('reading') as draw:
        draw(1, 2)
    monkeypatch.setattr(sys, 'stderr', file)
    monkeypatch.setattr(progress, '_DELAY_S', 0.0)
    with progress.progress('reading') as draw:
        draw(1, 2)
    assert (terminal.getvalue(), file.getvalue()) == ('', '')


@pytest.mark.parametrize('command', ['calibrate', 'inspect', 'simulate'])
def test_long_work_shows_a_clock_on_a_terminal_and_clears_it(
        tmp_path, monkeypatch, capsys, command):
    a, b, _ = write_pair(tmp_path)
    arguments = {'calibrate': [a, b, '--solver', 'taylor', '--reference', 'B5'],
                 'inspect': [a],
                 'simulate': ['--output', str(tmp_path / 'out'), '--scenario', 'noise',
                              '--force']}[command]
    monkeypatch.setattr(progress, '_DELAY_S', 0.0)
    terminal = _Terminal()
    monkeypatch.setattr(sys, 'stderr', terminal)
    assert main([command, *arguments]) == 0
    shown = terminal.getvalue()
    work = {'calibrate': ['reading', 'calibrating'], 'inspect': ['reading'],
            'simulate': ['simulating']}[command]
    # On a busy machine the clock counts on.
    assert re.sub(r'(\r\w+, )0 s(\1\d+ s)*', r'\g<1>0 s', shown) == ''.join(
        f'\r{name}, 0 s\r\033[K' for name in work)
    # Whatever came out after it came out after it was cleared.
    assert '\r' not in capsys.readouterr().out
    file = io.StringIO()
    monkeypatch.setattr(sys, 'stderr', file)
    assert main([command, *arguments]) == 0
    assert file.getvalue() == ''


def test_a_clock_counts_and_is_cleared_before_an_error(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr(sys, 'stderr', terminal)
    monkeypatch.setattr(progress, '_DELAY_S', 0.0)
    monkeypatch.setattr(progress, '_UPDATE_S', 0.01)
    with pytest.raises(SolverError), progress.progress('calibrating'):
        while terminal.getvalue().count('calibrating') < 3:
            time.sleep(0.01)
        raise SolverError('found nothing')
    assert terminal.getvalue().count('\rcalibrating, 0 s') >= 3
    assert terminal.getvalue().endswith('\r\033[K')


def test_arguments_of_the_process_are_the_default(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['trajectory_calibration', '--version'])
    assert main() == 0
    assert capsys.readouterr().out == f'trajectory_calibration {__version__}\n'
