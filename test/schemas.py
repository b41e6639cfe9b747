# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The JSON schemas of docs/."""

import json
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / 'docs'


def validator(name):
    """Return what checks data against a schema; skip the test where that is not installed."""
    jsonschema = pytest.importorskip('jsonschema', reason='jsonschema is not installed')
    schema = json.loads((DOCS / name).read_text(encoding='utf-8'))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)
