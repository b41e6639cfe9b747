# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read and write text and YAML files; a file is written completely or not at all."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
import math
import os
from pathlib import Path
import re
from typing import Any, TypeVar

from trajectory_calibration.errors import CalibrationError, in_words, ResultError

_Built = TypeVar('_Built')

# Errors of malformed YAML that the library does not turn into its own: impossible dates,
# "!!int abc", "!!int ''", "!!bool x", integers that are too long for Python, brackets nested
# beyond the recursion limit. Found by random text.
_MALFORMED = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)

# Words that YAML 1.1 reads as booleans, null or floats.
_YAML_KEYWORDS = frozenset((
    'y', 'n', 'yes', 'no', 'on', 'off', 'true', 'false', 'null', 'nan', 'inf'))


def read_yaml(path: Path, what: str, error: type[CalibrationError]) -> Any:
    """Return the content of a YAML file, read in safe mode.

    Raises
    ------
    CalibrationError
        ``error``, with the message that ``path`` cannot be read as ``what``.

    """
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, ValueError) as cause:
        raise error(f'{path} cannot be read as {what}: {in_words(cause)}') from cause
    return parse_yaml(text, f'{path} cannot be read as {what}', error)


def load_yaml(
    path: Path, build: Callable[[dict[str, Any]], _Built], error: type[CalibrationError],
    what: str, otherwise: str,
) -> _Built:
    """Return ``build`` of the mapping in a YAML file.

    Raises ``error``, with the path in the message, if the file cannot be read as ``what``, if it
    holds no mapping (message ``otherwise``), or if ``build`` raises ``error``.
    """
    data = read_yaml(path, what, error)
    if not isinstance(data, dict):
        raise error(f'{path} holds {otherwise}')
    try:
        return build(data)
    except error as cause:
        raise error(f'{path}: {cause}') from cause


def parse_yaml(text: str, failure: str, error: type[CalibrationError]) -> Any:
    """Return the content of a YAML text; raise ``error`` with ``failure`` and the cause."""
    # Imported here because most runs read no YAML.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    try:
        return YAML(typ='safe', pure=True).load(text)
    except YAMLError as cause:
        reason = str(cause).replace('in "<unicode string>", ', 'in ')
        raise error(f'{failure}: {reason}') from cause
    except _MALFORMED as cause:
        # in_words would call a failed lookup a missing key; here a value is malformed.
        reason = 'malformed value' if isinstance(cause, LookupError) else in_words(cause)
        raise error(f'{failure}: {reason}') from cause


def to_yaml(data: dict[str, Any]) -> str:
    """Return plain data as YAML that means the same in versions 1.1 and 1.2; keys stay in order.

    PyYAML, and so ROS and xacro, read version 1.1: there ``1e-05`` is a text, ``off`` a boolean
    and ``1:30`` a time.
    """
    # Imported here because most uses of a result need no YAML.
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import SafeRepresenter

    class Representer(SafeRepresenter):
        pass

    Representer.add_representer(
        float, lambda self, value: self.represent_scalar('tag:yaml.org,2002:float', number(value)))
    Representer.add_representer(
        str, lambda self, text: self.represent_scalar(
            'tag:yaml.org,2002:str', text, style=None if _is_plain(text) else '"'))
    yaml = YAML(typ='safe', pure=True)
    yaml.Representer = Representer
    yaml.representer.sort_base_mapping_type_on_output = False
    yaml.default_flow_style = None
    yaml.width = 99
    stream = StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def number(value: float) -> str:
    """Return the shortest text that reads back as the same float in YAML 1.1 and 1.2, XML, C."""
    if not math.isfinite(value):
        return '.nan' if math.isnan(value) else '.inf' if value > 0 else '-.inf'
    text = repr(float(value) + 0.0)
    return text.replace('e', '.0e') if 'e' in text and '.' not in text else text


def quoted(text: str) -> str:
    """Return a text in double quotes, as YAML 1.1 and 1.2 both read it."""
    # Python's escapes are valid in YAML, too.
    escaped = ''.join(
        character if character.isprintable() and character != '\\' else
        character.encode('unicode_escape').decode() for character in text)
    return '"' + escaped.replace('"', '\\"') + '"'


def _is_plain(text: str) -> bool:
    """Return whether every version of YAML reads the text without quotes as this text."""
    # The first word starts with a letter or a slash; the library quotes the rest if needed.
    first = text.partition(' ')[0]
    return (first != '' and re.fullmatch(r'/?[A-Za-z][\w/.,;()%+-]*', first) is not None
            and text.lower() not in _YAML_KEYWORDS and text.isprintable())


def write_yaml(path: Path, data: dict[str, Any], *, overwrite: bool = True) -> None:
    """Write plain data as YAML, completely or not at all; it is on disk when this returns.

    Without ``overwrite``, the temporary file locks ``path``: only one of several processes
    writes it. After a power cut the temporary file remains, and the name stays locked.

    Raises
    ------
    FileExistsError
        Without ``overwrite``: the file exists, or another process is writing it.
    ResultError
        The file cannot be written.

    """
    _write(path, to_yaml(data), ResultError, overwrite=overwrite, sync=True)


def make_folder(path: Path, error: type[CalibrationError]) -> None:
    """Make a folder and its parents; raise ``error`` if this fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise error(f'{path} cannot be made: {in_words(cause)}') from cause


def write_text(
    path: Path, text: str | bytes, error: type[CalibrationError] = ResultError,
) -> None:
    """Write a UTF-8 file, completely or not at all; make its folder, overwrite an older file."""
    make_folder(path.parent, error)
    _write(path, text, error)


def _write(
    path: Path, data: str | bytes, error: type[CalibrationError], *, overwrite: bool = True,
    sync: bool = False,
) -> None:
    """Write a temporary file in the same folder, then rename it.

    A link keeps its place and its target is replaced; a device or a pipe is written directly.
    ``sync`` waits for the disk. Raises ``error`` and FileExistsError.
    """
    if isinstance(data, str):
        # A report shows file names, which need not be UTF-8.
        data = data.encode(errors='backslashreplace')
    try:
        if overwrite:
            if path.exists() and not path.is_file() and not path.is_dir():
                path.write_bytes(data)
                return
            # After the test for devices: /dev/stdout is a link to a pipe without a path.
            path = path.resolve() if path.is_symlink() else path
        temporary = path.with_name(f'.{path.name}.{os.urandom(8).hex() if overwrite else "new"}')
        # Not ``tempfile``: its files are private, this one gets the user's usual permissions.
        with temporary.open('xb') as stream:
            try:
                if not overwrite and os.path.lexists(path):
                    raise FileExistsError(path)
                stream.write(data)
                stream.flush()
                if sync:
                    os.fsync(stream.fileno())
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
    except FileExistsError:
        raise
    except OSError as cause:
        raise error(f'{path} cannot be written: {in_words(cause)}') from cause
    except ValueError as cause:
        # A path without a name, or one with a zero byte.
        raise error(f'{str(path)!r} cannot be written: {cause}') from cause
