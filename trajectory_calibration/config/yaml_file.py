"""Text and YAML in and out of files, whole or not at all, or a named error."""

from __future__ import annotations

import errno
from io import StringIO
import os
from pathlib import Path
from secrets import token_hex
from typing import Any

from trajectory_calibration.errors import CalibrationError, ResultError

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


def to_yaml(data: dict[str, Any]) -> str:
    """Return plain data as YAML, keys in their own order."""
    # Loads here because most uses of a result never touch YAML.
    from ruamel.yaml import YAML
    yaml = YAML(typ='safe', pure=True)
    yaml.representer.sort_base_mapping_type_on_output = False
    yaml.default_flow_style = None
    yaml.width = 99
    stream = StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def write_yaml(path: Path, data: dict[str, Any], *, overwrite: bool = True) -> None:
    """Write plain data as YAML through a temporary file in the same folder and a rename.

    Without ``overwrite``, the name of the temporary file is a claim to ``path``: of several
    processes one gets it. A claim that a power cut left behind stays, and so does the name.

    Raises
    ------
    FileExistsError
        Without ``overwrite``: the file exists, or another process is writing it.
    ResultError
        The file cannot be written.

    """
    created = False
    try:
        temporary = path.with_name(f'.{path.name}.{token_hex(8) if overwrite else "new"}')
        # Not through ``tempfile``, whose files are private: the kernel gives this one the
        # permissions of any new file of this user.
        with temporary.open('x', encoding='utf-8') as stream:
            created = True
            if not overwrite:
                _require_absent(path)
            stream.write(to_yaml(data))
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
        created = False
    except FileExistsError:
        raise
    except OSError as error:
        raise ResultError(f'{path} cannot be written: {error.strerror or error}') from error
    except ValueError as error:
        # A path without a name, or with a zero byte in it.
        raise ResultError(f'{str(path)!r} cannot be written: {error}') from error
    finally:
        if created:
            temporary.unlink(missing_ok=True)


def _require_absent(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def write_text(path: Path, text: str, error: type[CalibrationError]) -> None:
    """Write UTF-8 over what is at ``path``; raise ``error`` where it cannot be written."""
    try:
        path.write_text(text, encoding='utf-8')
    except OSError as cause:
        raise error(f'{path} cannot be written: {cause.strerror or cause}') from cause
