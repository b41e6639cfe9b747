"""YAML out of a file, or a named error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trajectory_calibration.errors import CalibrationError

# What the YAML library lets through besides its own errors: dates that no calendar has,
# "!!int abc", "!!int ''", "!!bool x", numbers of more digits than Python converts, brackets
# nested deeper than Python calls. Found by random text.
_MALFORMED = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def read_yaml(path: Path, what: str, error: type[CalibrationError]) -> Any:
    """Return what a YAML file holds, read in safe mode.

    Raises
    ------
    CalibrationError
        ``error``, which says that ``path`` cannot be read as ``what``.

    """
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, ValueError) as cause:
        raise error(f'{path} cannot be read as {what}: {cause}') from cause
    return parse_yaml(text, f'{path} cannot be read as {what}', error)


def parse_yaml(text: str, failure: str, error: type[CalibrationError]) -> Any:
    """Return what a text of YAML holds; raise ``error`` with ``failure`` and the cause."""
    # The YAML library loads here because most runs need none.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    try:
        return YAML(typ='safe', pure=True).load(text)
    except YAMLError as cause:
        raise error(f'{failure}: {cause}') from cause
    except _MALFORMED as cause:
        raise error(f'{failure}: {type(cause).__name__}: {cause}') from cause
