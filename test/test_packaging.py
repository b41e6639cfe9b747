# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What pip and colcon make of the package."""

from configparser import ConfigParser
from email.parser import Parser
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree as ET
from zipfile import ZipFile

import pytest

import trajectory_calibration

pytestmark = pytest.mark.once
ROOT = Path(__file__).resolve().parents[1]
NAME = 'trajectory_calibration'
EXECUTABLES = ('calibration_node', NAME)
SOURCES = (
    'CHANGELOG.md', 'LICENSE', 'README.md', 'config', 'launch', 'package.xml', 'pyproject.toml',
    'resource', 'setup.cfg', 'setup.py', 'test', NAME)


@pytest.fixture
def source(tmp_path):
    """Return a copy of the package, so that building it leaves nothing behind here."""
    folder = tmp_path / 'src' / NAME
    folder.mkdir(parents=True)
    for item in map(ROOT.joinpath, SOURCES):
        if item.is_dir():
            shutil.copytree(item, folder / item.name,
                            ignore=shutil.ignore_patterns('__pycache__', '*.egg-info'))
        elif item.exists():
            shutil.copy(item, folder)
    return folder


def run(*command, cwd, **environment):
    """Run a command and return its standard output; show both outputs where it fails."""
    # The working directory must not decide what is imported.
    env = {key: value for key, value in os.environ.items() if key != 'PYTHONPATH'}
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env={**env, **environment}, capture_output=True, text=True,
        timeout=300, check=False)
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout


def test_one_version():
    xml = ET.parse(ROOT / 'package.xml')
    assert xml.findtext('version') == trajectory_calibration.__version__
    changes = re.findall(r'^## (\S+)', (ROOT / 'CHANGELOG.md').read_text(), re.MULTILINE)
    assert changes[0] == trajectory_calibration.__version__


def test_package_xml_declares_what_the_code_imports():
    declared = {
        item.text for item in ET.parse(ROOT / 'package.xml').iter('exec_depend')}
    used = set()
    for path in [*(ROOT / NAME / 'ros').glob('*.py'), *(ROOT / 'launch').glob('*.py')]:
        used |= set(re.findall(
            r'^\s*(?:from|import) '
            r'(rclpy|\w+_msgs|\w+_interfaces|std_srvs|launch|launch_ros|ament_\w+)\b',
            path.read_text(encoding='utf-8'), re.MULTILINE))
    assert {'rclpy', 'launch'} <= used
    assert used <= declared


def test_wheel(source, tmp_path):
    pytest.importorskip('setuptools', '70.1', reason='older ones make no wheels on their own')
    run(sys.executable, '-m', 'pip', 'wheel', '--quiet', '--no-deps', '--no-build-isolation',
        '--wheel-dir', tmp_path, source, cwd=tmp_path)
    (wheel,) = tmp_path.glob('*.whl')
    with ZipFile(wheel) as archive:
        names = archive.namelist()
        info = f'{NAME}-{trajectory_calibration.__version__}.dist-info'
        points = ConfigParser()
        points.read_string(archive.read(f'{info}/entry_points.txt').decode())
        metadata = Parser().parsestr(archive.read(f'{info}/METADATA').decode())
    assert set(points['console_scripts']) == set(EXECUTABLES)
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / NAME).rglob('*.py')}
    # Nothing but the package is importable, and all of it is.
    assert {name for name in names if name.endswith('.py') and '.data/' not in name} == modules
    assert f'{NAME}/py.typed' in names
    share = {name.partition('/data/share/')[2] for name in names if '/data/share/' in name}
    assert {f'ament_index/resource_index/packages/{NAME}', f'{NAME}/package.xml'} <= share
    for folder in ('config', 'launch'):
        files = {f'{NAME}/{path.relative_to(ROOT)}' for path in (ROOT / folder).glob('*.*')}
        assert files
        assert files <= share
    assert 'numpy' in {
        re.match(r'[\w.-]+', line)[0] for line in metadata.get_all('Requires-Dist')
        if 'extra' not in line}
    assert not any('ros-' in line and 'extra' not in line
                   for line in metadata.get_all('Requires-Dist'))


@pytest.mark.skipif('COLCON' in os.environ, reason='this is colcon test itself')
@pytest.mark.usefixtures('source')
def test_colcon(tmp_path):
    pytest.importorskip('colcon_core', reason='colcon is not installed')
    colcon = [sys.executable, '-m', 'colcon', '--log-base', 'log']
    assert run(*colcon, 'list', cwd=tmp_path).split() == [
        NAME, f'src/{NAME}', '(ros.ament_python)']
    prefix = {'AMENT_PREFIX_PATH': sys.prefix}
    run(*colcon, 'build', cwd=tmp_path, **prefix)
    installed = tmp_path / 'install' / NAME
    # Where `ros2 run` looks for executables, and `ros2 launch` for files.
    for name in EXECUTABLES:
        assert os.access(installed / 'lib' / NAME / name, os.X_OK)
    for name in ('package.xml', 'launch', 'config'):
        assert (installed / 'share' / NAME / name).exists()
    version = run(
        'bash', '-c', f'source install/setup.bash && install/{NAME}/lib/{NAME}/{NAME} --version',
        cwd=tmp_path, **prefix)
    assert version.strip() == f'{NAME} {trajectory_calibration.__version__}'
    run(*colcon, 'test', '--return-code-on-test-failure', '--pytest-args',
        'test/test_packaging.py', '-k', 'version or package_xml', cwd=tmp_path, **prefix)
    summary = run(*colcon, 'test-result', cwd=tmp_path)
    assert re.search(r'Summary: 2 tests, 0 errors, 0 failures, 0 skipped', summary)


def test_every_file_of_code_names_its_licence():
    head = ('# Copyright 2026 trajectory_calibration maintainers\n'
            '# SPDX-License-Identifier: Apache-2.0\n')
    files = [path for folder in (NAME, 'test', 'launch') for path in (ROOT / folder).rglob('*.py')]
    assert [path for path in files if head not in path.read_text(encoding='utf-8')[:200]] == []
