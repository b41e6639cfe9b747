# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""The console script ``trajectory_calibration``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
import io
import os
from pathlib import Path
import re
import shlex
import sys

from trajectory_calibration import exit_status
from trajectory_calibration.cli.inputs import split_bags
from trajectory_calibration.cli.options import join_negative_values
from trajectory_calibration.errors import CalibrationError, ConfigError, missing_package
from trajectory_calibration.sources.text import is_bag
from trajectory_calibration.version import __version__

# Each is a module with add_parser(subparsers) and run(arguments), which returns the exit status.
_COMMANDS = (
    'calibrate', 'report', 'inspect', 'export', 'verify', 'compare', 'rig', 'fleet', 'simulate',
    'replay')


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return its exit status, see ``exit_status``.

    ``argv`` are the arguments without the program's name, by default those of the process.
    """
    return guarded(_run, sys.argv[1:] if argv is None else argv)


def guarded(command: Callable[[Sequence[str]], int], argv: Sequence[str]) -> int:
    """Run a command; print its error on standard error and return the exit status."""
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:
            # The caller closed it (>&-): continue, also in child processes.
            setattr(sys, name, Path(os.devnull).open('w', encoding='utf-8'))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A frame name with characters that the terminal lacks must not raise.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        status = command(argv)
        # argparse ignores write errors; unlike sys.stdout.flush(), this raises them.
        print(end='', flush=True)
    except CalibrationError as error:
        return _fail(str(error), exit_status.USAGE if isinstance(error, ConfigError)
                     else exit_status.NO_ANSWER)
    except ModuleNotFoundError as error:
        return _fail(str(missing_package(error)), exit_status.NO_ANSWER)
    except KeyboardInterrupt:
        return exit_status.INTERRUPTED
    except BrokenPipeError:
        # The reader, such as head, closed the pipe.
        _discard_output()
        return exit_status.DONE
    except OSError as error:
        if error.filename is not None:
            return _fail(f'{error.filename}: {error.strerror}', exit_status.NO_ANSWER)
        _discard_output()
        return _fail(f'standard output cannot be written: {error.strerror or error}; free space, '
                     'or write elsewhere', exit_status.NO_ANSWER)
    return status


def _run(argv: Sequence[str]) -> int:
    parser, commands = _parser(argv)
    if '_ARGCOMPLETE' in os.environ:
        # Shell completion; the extra ``completion`` may not be installed.
        with suppress(ModuleNotFoundError):
            import argcomplete
            argcomplete.autocomplete(parser)
    try:
        arguments, unknown = parser.parse_known_args(split_bags(join_negative_values(argv)))
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else exit_status.USAGE
    if unknown:
        raise ConfigError(_describe_unknown(unknown[0], argv, commands))
    arguments.argv = list(argv)
    return int(arguments.run(arguments))


def _describe_unknown(
    argument: str, argv: Sequence[str], commands: Mapping[str, argparse.ArgumentParser],
) -> str:
    """Return the error message for an argument that a command does not know."""
    command = next(name for name in argv if name in _COMMANDS)
    given = argument.partition('=')[0]
    near = get_close_matches(
        given, re.findall(r'--[a-z-]+', commands[command].format_help()), n=1)
    hint = f'; did you mean {near[0]}?' if near else '.'
    kind = 'option' if given.startswith('-') else 'argument'
    bags = [name for name in argv if is_bag(Path(name))]
    if kind == 'argument' and bags and '--bag' not in argv:
        hint = f'; a bag is an option: --bag {shlex.quote(bags[0])}.'
    return f'{command} takes no {kind} {given}{hint} See {command} --help'


def _fail(reason: str, status: int) -> int:
    print(f'error: {" ".join(reason.split())}', file=sys.stderr)
    return status


def _discard_output() -> None:
    """Redirect standard output to the null device: Python flushes it again at exit."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser(
    argv: Sequence[str],
) -> tuple[argparse.ArgumentParser, Mapping[str, argparse.ArgumentParser]]:
    """Return the parser, and the parsers of the commands by name."""
    parser = argparse.ArgumentParser(
        prog='trajectory_calibration',
        description='Estimate the extrinsic transform between two sensors from their trajectories '
        'alone.')
    parser.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    subparsers = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    # Importing all commands takes as long as a calibration: only for help, completion and wrong
    # usage.
    for command in argv[:1] if argv and argv[0] in _COMMANDS else _COMMANDS:
        module = import_module(f'trajectory_calibration.cli.{command}')
        module.add_parser(subparsers)
        subparsers.choices[command].set_defaults(run=module.run)
    return parser, subparsers.choices
