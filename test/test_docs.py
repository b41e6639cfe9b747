# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The documentation site builds without a warning and says what the code says."""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
import re
import subprocess
import sys

import pytest

from trajectory_calibration.data.findings import CATALOGUE, LEVELS

pytestmark = pytest.mark.once
ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
# What a command wrote, benchmark/, is no page.
PAGES = [*ROOT.glob('*.md'), *DOCS.glob('*.md'), *DOCS.glob('tutorials/*.md'),
         *DOCS.glob('drift_aware/*.md'), *DOCS.glob('benchmarks/*.md')]


def test_every_code_of_a_finding_is_documented():
    spec = spec_from_file_location('findings_table', DOCS / 'findings_table.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (DOCS / 'findings.md').read_text(encoding='utf-8')
    assert page.endswith(module.table()), 'run: python docs/findings_table.py'


def test_prose_has_at_most_99_columns():
    # Tables cannot be wrapped, and code blocks show real output.
    assert len(PAGES) > 20
    for page in PAGES:
        is_code = False
        for number, line in enumerate(page.read_text(encoding='utf-8').splitlines(), 1):
            is_code ^= line.startswith('```')
            if not is_code and not line.startswith(('|', '    ')):
                assert len(line) <= 99, f'{page.name}, line {number}'


def test_modules_and_benchmarks_that_pages_name_exist():
    files = {'/' + path.relative_to(ROOT).as_posix()
             for folder in ('trajectory_calibration', 'benchmarks', 'demo', 'docs', 'test')
             for path in (ROOT / folder).rglob('*.py')}
    named = 0
    for page in PAGES:
        text = page.read_text(encoding='utf-8')
        wanted = re.findall(r'`([\w/]+\.py)`', text)
        wanted += [f'benchmarks/{name}.py' for name in re.findall(r'-m benchmarks\.(\w+)', text)
                   if not (ROOT / 'benchmarks' / name).is_dir()]
        named += len(wanted)
        for name in wanted:
            assert any(path.endswith(f'/{name}') for path in files), f'{page.name}: {name}'
    assert named > 30


def test_codes_are_kebab_case_and_levels_are_known():
    for code, (level, meaning) in CATALOGUE.items():
        assert code == code.lower()
        assert set(code) <= set('abcdefghijklmnopqrstuvwxyz0123456789-')
        assert level in LEVELS
        assert meaning
        assert not meaning.endswith('.')


@pytest.mark.skipif(find_spec('sphinx') is None or find_spec('furo') is None,
                    reason='sphinx, myst-parser and furo are not installed')
def test_the_site_builds_without_a_warning(tmp_path):
    done = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', '-b', 'html', str(DOCS),
         str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / 'index.html').exists()
