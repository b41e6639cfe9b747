# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text and YAML in and out of files, whole or not at all, or a named error."""

from __future__ import annotations

from io import StringIO
import math
import os
from pathlib import Path
import re
from typing import Any

from trajectory_calibration.errors import CalibrationError, in_words, ResultError

# What the YAML library lets through besides its own errors: dates that no calendar has,
# "!!int abc", "!!int ''", "!!bool x", numbers of more digits than Python converts, brackets
# nested deeper than Python calls. Found by random text.
_MALFORMED = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)

# What YAML 1.1 takes for a truth value or for nothing.
_WORDS_OF_YAML = frozenset((
    'y', 'n', 'yes', 'no', 'on', 'off', 'true', 'false', 'null', 'nan', 'inf'))


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
        raise error(f'{path} cannot be read as {what}: {in_words(cause)}') from cause
    return parse_yaml(text, f'{path} cannot be read as {what}', error)


def parse_yaml(text: str, failure: str, error: type[CalibrationError]) -> Any:
    """Return what a text of YAML holds; raise ``error`` with ``failure`` and the cause."""
    # The YAML library loads here because most runs need none.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    try:
        return YAML(typ='safe', pure=True).load(text)
    except YAMLError as cause:
        # The library calls a text that it did not read from a file by a name of its own.
        reason = str(cause).replace('in "<unicode string>", ', 'in ')
        raise error(f'{failure}: {reason}') from cause
    except _MALFORMED as cause:
        # What it looks up are the values: nothing is missing.
        reason = 'malformed value' if isinstance(cause, LookupError) else in_words(cause)
        raise error(f'{failure}: {reason}') from cause


def to_yaml(data: dict[str, Any]) -> str:
    """Return plain data as YAML that means the same in versions 1.1 and 1.2; keys stay in order.

    PyYAML, and so ROS and xacro, read version 1.1: there ``1e-05`` is a text, ``off`` a truth
    value and ``1:30`` a time.
    """
    # Loads here because most uses of a result never touch YAML.
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
    # The escapes of Python are escapes of YAML, too.
    escaped = ''.join(
        character if character.isprintable() and character != '\\' else
        character.encode('unicode_escape').decode() for character in text)
    return '"' + escaped.replace('"', '\\"') + '"'


def _is_plain(text: str) -> bool:
    """Tell whether no version of YAML takes a text without quotes for anything but a text."""
    # A word that begins with a letter or a slash; or a sentence of such, which the library
    # quotes where it has to.
    first = text.partition(' ')[0]
    return (first != '' and re.fullmatch(r'/?[A-Za-z][\w/.,;()%+-]*', first) is not None
            and text.lower() not in _WORDS_OF_YAML and text.isprintable())


def write_yaml(path: Path, data: dict[str, Any], *, overwrite: bool = True) -> None:
    """Write plain data as YAML, whole or not at all; it is on disk when this returns.

    Without ``overwrite``, the name of the temporary file is a claim to ``path``: of several
    processes one gets it. A claim that a power cut left behind stays, and so does the name.

    Raises
    ------
    FileExistsError
        Without ``overwrite``: the file exists, or another process is writing it.
    ResultError
        The file cannot be written.

    """
    _write(path, to_yaml(data), ResultError, overwrite=overwrite, lasting=True)


def make_folder(path: Path, error: type[CalibrationError]) -> None:
    """Make a folder and those above it; raise ``error`` where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise error(f'{path} cannot be made: {in_words(cause)}') from cause


def write_text(
    path: Path, text: str | bytes, error: type[CalibrationError] = ResultError,
) -> None:
    """Write over what is at ``path``, whole or not at all, in UTF-8, in a folder that is made."""
    make_folder(path.parent, error)
    _write(path, text, error)


def _write(
    path: Path, data: str | bytes, error: type[CalibrationError], *, overwrite: bool = True,
    lasting: bool = False,
) -> None:
    """Write a file through a temporary one in the same folder and a rename.

    Of a link, the file that it names; a device or a pipe takes the bytes as they are. ``lasting``
    waits for the disk: what can be made again need not. Raises ``error`` and FileExistsError.
    """
    if isinstance(data, str):
        # The name of a file need be no UTF-8, and stands on a page.
        data = data.encode(errors='backslashreplace')
    try:
        if overwrite:
            if path.exists() and not path.is_file() and not path.is_dir():
                path.write_bytes(data)
                return
            # Not before: /dev/stdout is a link to what has no name.
            path = path.resolve() if path.is_symlink() else path
        temporary = path.with_name(f'.{path.name}.{os.urandom(8).hex() if overwrite else "new"}')
        # Not through ``tempfile``, whose files are private: the kernel gives this one the
        # permissions of any new file of this user.
        with temporary.open('xb') as stream:
            try:
                if not overwrite and os.path.lexists(path):
                    raise FileExistsError(path)
                stream.write(data)
                stream.flush()
                if lasting:
                    os.fsync(stream.fileno())
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
    except FileExistsError:
        raise
    except OSError as cause:
        raise error(f'{path} cannot be written: {in_words(cause)}') from cause
    except ValueError as cause:
        # A path without a name, or with a zero byte in it.
        raise error(f'{str(path)!r} cannot be written: {cause}') from cause
