# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The documentation site builds without a warning and says what the code says."""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
import subprocess
import sys

import pytest

from trajectory_calibration.data.findings import CATALOGUE, LEVELS

pytestmark = pytest.mark.once
DOCS = Path(__file__).resolve().parents[1] / 'docs'


def test_every_code_of_a_finding_is_documented():
    spec = spec_from_file_location('findings_table', DOCS / 'findings_table.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (DOCS / 'findings.md').read_text(encoding='utf-8')
    assert page.endswith(module.table()), 'run: python docs/findings_table.py'


def test_prose_has_at_most_99_columns():
    # Tables cannot be wrapped, code blocks show real output, and a command writes benchmark/.
    pages = [*DOCS.parent.glob('*.md'), *DOCS.glob('*.md'), *DOCS.glob('tutorials/*.md'),
             *DOCS.glob('drift_aware/*.md'), *DOCS.glob('benchmarks/*.md')]
    assert len(pages) > 20
    for page in pages:
        is_code = False
        for number, line in enumerate(page.read_text(encoding='utf-8').splitlines(), 1):
            is_code ^= line.startswith('```')
            if not is_code and not line.startswith(('|', '    ')):
                assert len(line) <= 99, f'{page.name}, line {number}'


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
