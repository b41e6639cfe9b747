# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every command of the tutorials runs, and ends as the page says."""

import json
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.once
TUTORIALS = Path(__file__).resolve().parents[2] / 'docs' / 'tutorials'

# A fenced block of shell; before it, in a comment, the exit status where it is not 0.
BLOCK = re.compile(r'(?:<!-- status (\d) -->\n)?```sh\n(.*?)```', re.DOTALL)


def environment(folder):
    """Return an environment in which ``trajectory_calibration`` is this package."""
    script = folder / 'trajectory_calibration'
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m trajectory_calibration "$@"\n')
    script.chmod(0o755)
    return {**os.environ, 'PATH': f'{folder}:{os.environ["PATH"]}', 'COLUMNS': '80',
            'PYTHONPATH': str(TUTORIALS.parents[1])}


@pytest.mark.parametrize('page', ['bag_to_urdf', 'forklift', 'fleet'])
def test_the_commands_of_a_page(page, tmp_path):
    (tmp_path / 'bin').mkdir()
    (tmp_path / 'work').mkdir()
    variables = environment(tmp_path / 'bin')
    blocks = BLOCK.findall((TUTORIALS / f'{page}.md').read_text(encoding='utf-8'))
    assert len(blocks) >= 4
    for status, commands in blocks:
        done = subprocess.run(
            ['bash', '-e', '-c', commands], cwd=tmp_path / 'work', env=variables, check=False,
            capture_output=True, text=True)
        assert done.returncode == int(status or 0), f'{commands}\n{done.stdout}\n{done.stderr}'
    outputs = {
        'bag_to_urdf': ('drive/camera_joint.urdf', 'camera_link'),
        'forklift': ('second/extrinsic.urdf', 'camera'),
        'fleet': ('three_days/fleet.html', 'CHANGED: day1-3 | day4'),
    }
    name, words = outputs[page]
    assert words in (tmp_path / 'work' / name).read_text(encoding='utf-8')


def test_the_cells_of_the_notebook(tmp_path, monkeypatch, capsys):
    # Not through a kernel: Jupyter's packages weigh more than everything else the tests need,
    # and what a cell says in Python is all that can break here.
    notebook = json.loads((TUTORIALS / 'two_tum_files.ipynb').read_text(encoding='utf-8'))
    assert notebook['nbformat'] == 4
    monkeypatch.chdir(tmp_path)
    names = {}
    cells = [cell for cell in notebook['cells'] if cell['cell_type'] == 'code']
    for cell in cells:
        assert cell['outputs'] == []
        exec(compile(''.join(cell['source']), 'cell', 'exec'), names)
    assert len(cells) >= 5
    assert names['error'].e_at < 0.03
    assert (tmp_path / 'mount.urdf').read_text().startswith('<!--')
    assert '<joint name="lidar_to_camera"' in capsys.readouterr().out
