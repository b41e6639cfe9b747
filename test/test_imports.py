# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The direction of imports: up the flow, ROS only at its place, nothing heavy at the start."""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

pytestmark = pytest.mark.once
PACKAGE = Path(__file__).resolve().parents[1] / 'trajectory_calibration'
NAME = PACKAGE.name

# From the top of the flow to its end. A module imports what stands before its own line, and
# its own package. The registry of solvers stands before the configuration, which offers their
# names; the solvers stand after it.
FLOW = (
    ('errors', 'exit_status', 'version'),
    ('executor',),
    ('geometry',),
    ('data',),
    ('solvers.registry',),
    ('solvers.__init__',),
    ('config',),
    ('time_alignment', 'sources', 'simulation'),
    ('solvers',),
    ('assessment',),
    ('result',),
    ('pipeline',),
    ('rig',),
    ('__init__',),
    ('fleet',),
    ('outputs',),
    ('online',),
    ('ros',),
    ('cli',),
    ('__main__',),
)
ROS = {'builtin_interfaces', 'rcl_interfaces', 'rclpy', 'std_srvs', 'tf2_ros'}
HEAVY = ('casadi', 'matplotlib', 'rclpy', 'rosbags', 'ruamel.yaml', 'scipy')

MODULES = sorted(PACKAGE.rglob('*.py'))


def dotted(path):
    """Return the name of a module below the package: 'solvers.dnl', 'solvers.__init__'."""
    return '.'.join(path.relative_to(PACKAGE).with_suffix('').parts)


def layer(module):
    """Return where a module stands in the flow, and the entry that says so."""
    entries = {entry: k for k, entries in enumerate(FLOW) for entry in entries}
    for candidate in (module, module.split('.')[0]):
        if candidate in entries:
            return entries[candidate], candidate
    pytest.fail(f'{module} has no place in the flow of imports')


def imports(path):
    """Yield the name of everything that a module imports when it runs, wherever it does so."""
    waiting = [ast.parse(path.read_text(encoding='utf-8'))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == 'TYPE_CHECKING':
            waiting.extend(node.orelse)
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f'{node.module}.{alias.name}' for alias in node.names)
        waiting.extend(ast.iter_child_nodes(node))


def own_module(name):
    """Return which of our modules an imported name comes from, or None."""
    parts = name.split('.')
    if parts[0] != NAME:
        return None
    while len(parts) > 1:
        base = PACKAGE.joinpath(*parts[1:])
        if base.with_suffix('.py').exists():
            return '.'.join(parts[1:])
        if (base / '__init__.py').exists():
            return '.'.join([*parts[1:], '__init__'])
        parts.pop()
    return '__init__'


@pytest.mark.parametrize('path', MODULES, ids=dotted)
def test_imports_go_up_the_flow(path):
    rank, entry = layer(dotted(path))
    for imported in filter(None, map(own_module, imports(path))):
        imported_rank, imported_entry = layer(imported)
        allowed = imported_rank < rank or imported_entry == entry
        assert allowed, f'{dotted(path)} imports {imported}, which comes after it in the flow'


@pytest.mark.parametrize('path', MODULES, ids=dotted)
def test_only_ros_imports_ros(path):
    if path.is_relative_to(PACKAGE / 'ros'):
        return
    roots = {name.split('.')[0] for name in imports(path)}
    assert not {root for root in roots if root in ROS or root.endswith('_msgs')}


def test_the_scan_sees_imports():
    found = set(imports(PACKAGE / 'pipeline.py'))
    assert f'{NAME}.solvers.load_solver' in found
    assert own_module(f'{NAME}.solvers.load_solver') == 'solvers.__init__'
    assert own_module(f'{NAME}.geometry.se3') == 'geometry.se3'


@pytest.mark.parametrize('module', [
    NAME, f'{NAME}.cli.main', f'{NAME}.simulation', f'{NAME}.sources'])
def test_import_loads_nothing_heavy(module):
    code = f'import sys, {module}; print(*sys.modules)'
    loaded = subprocess.run(
        [sys.executable, '-c', code], check=True, capture_output=True, text=True).stdout.split()
    assert module in loaded
    assert not set(HEAVY) & set(loaded)


def every_import(path):
    """Yield what a module imports anywhere, also for its annotations alone."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def test_no_circle_of_files():
    """Not under TYPE_CHECKING either: what needs each other to be read is one file."""
    waiting = {
        dotted(path): {name for name in map(own_module, every_import(path))
                       if name and name != dotted(path)} for path in MODULES}
    while waiting:
        free = [module for module, needs in waiting.items() if not needs & waiting.keys()]
        assert free, f'these import each other: {sorted(waiting)}'
        for module in free:
            del waiting[module]


@pytest.mark.parametrize('path', MODULES, ids=dotted)
def test_a_module_fits_on_a_few_screens(path):
    assert len(path.read_text(encoding='utf-8').splitlines()) <= 400


def test_no_module_of_tests_is_skipped_whole():
    """With launch_testing installed pytest then collects nothing, and reports success."""
    for path in sorted(Path(__file__).parent.rglob('*.py')):
        for line in path.read_text(encoding='utf-8').splitlines():
            assert line[:1].isspace() or 'importorskip(' not in line, path
            assert not line.startswith('pytest.skip('), path
