# SPDX-License-Identifier: Apache-2.0
"""Common part of all command-line tools: numbers in options, one-line errors, exit statuses."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from flock_sim.console.fault import TRACEBACK, disk_failure, fault
from flock_sim.console.signals import Ended, Endings
from flock_sim.console.stdout import open_missing_streams
from flock_sim.errors import FlockError, RunFailed, closest
from flock_sim.outside.printing import one_line, printable, shown

INTERRUPTED = 130
BROKEN_PIPE = 141

LONGEST = 1e9
"""Largest time that an option or parameter may set, in s."""

MOST = 2**53
"""The largest whole number that an option takes, unless it says otherwise."""

FAULT = 70
"""Exit status after an exception that is a fault of Flock; EX_SOFTWARE of sysexits.h."""

program = "./flock"
"""The command that runs the tools of this process."""

TIMEOUT = "60"
"""Longest standstill of a flight, in s, unless an option says otherwise."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, like all of Flock's."""

    def __init__(self, tool: str, description: str, examples: str) -> None:
        """Make the parser of `tool`; `examples` is the end of its help text."""
        super().__init__(
            prog=f"{program} {tool}",
            description=_by_this_command(description),
            epilog=_by_this_command(f"examples:\n{examples}"),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def format_help(self) -> str:
        """Return the help without spaces at the ends of lines."""
        return "".join(f"{line.rstrip()}\n" for line in super().format_help().splitlines())

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Do as argparse, but suggest the nearest option for one that the tool does not have."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            known = [option for option in self._option_string_actions if option.startswith("--")]
            option = next((word for word in unknown if word.startswith("--")), "")
            close = closest(option.partition("=")[0], known) if option else None
            hint = f", did you mean {close}?" if close else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return options, unknown

    def print_help(self, file: Any = None) -> None:
        """Print the help on stdout. Raises RunFailed if it can't be written."""
        _print(self.format_help().rstrip("\n"))

    def error(self, message: str) -> NoReturn:
        """Raise FlockError instead of printing the usage."""
        raise FlockError(f"{message}; {self.prog} --help tells more")


def _by_this_command(text: str) -> str:
    """Return a help text with the command that runs the tools here."""
    return text.replace("./flock ", f"{program} ")


def whole_number(name: str, text: str, least: int, most: int | None = None) -> int:
    """Return `text` as a whole number within bounds. Raises FlockError otherwise."""
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if most is None and value > MOST:
        most = MOST
    if value < least or (most is not None and value > most):
        allowed = f"{least}..{most}" if most is not None else f"{least} or more"
        raise FlockError(f"{name} {shown(text)}: must be a whole number, {allowed}")
    return value


def whole_numbers(name: str, text: str, least: int, most: int | None = None) -> list[int]:
    """Return the whole numbers in `text`, between commas. Raises FlockError as `whole_number`."""
    try:
        return [whole_number(name, part.strip(), least, most) for part in text.split(",")]
    except FlockError as error:
        if "," not in text:
            raise
        raise FlockError(f"{error} (in {name} {shown(text)})") from None


def numbers(text: str) -> list[float]:
    """Return the numbers in `text`, between commas; [nan] if one is not a number."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return [math.nan]


def positive_number(name: str, text: str) -> float:
    """Return `text` as a number of seconds above 0. Raises FlockError otherwise."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value <= LONGEST:
        raise FlockError(
            f"{name} {shown(text)}: must be a finite number above 0, {LONGEST:g} at most"
        )
    return value


def not_negative_number(name: str, text: str) -> float:
    """Return `text` as a finite number, 0 or more. Raises FlockError otherwise."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= LONGEST:
        raise FlockError(f"{name} {shown(text)}: must be a number from 0 to {LONGEST:g}")
    return value


def print_json(value: dict[str, Any]) -> None:
    """Print `value` as one JSON object on stdout."""
    _print(json.dumps(value))


def note(line: str) -> None:
    """Print a line that is no result on stderr, so that stdout has results only.

    Its names may come from a file or a message.
    """
    try:
        print(one_line(line), file=sys.stderr, flush=True)
    except BrokenPipeError:
        raise
    except OSError:  # a full device: no line can tell it
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115


def print_text(text: str) -> None:
    """Print lines of a result on stdout. Their names may come from a file or a message."""
    _print("\n".join(map(printable, text.split("\n"))))


def _print(text: str) -> None:
    """Print `text` on stdout. Raises RunFailed if it can't be written."""
    try:
        print(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise _output_failed(error) from None


def run_tool(tool: Callable[[Sequence[str]], int], arguments: Sequence[str] | None = None) -> int:
    """Run `tool` and return its exit status.

    It is 0, 1 (answer is no, or a run or a disk failed), 2 (bad input), 70 (a fault of Flock)
    or 130 (Ctrl-C).
    """
    open_missing_streams()
    try:
        with Endings():
            try:
                return tool(sys.argv[1:] if arguments is None else arguments)
            finally:
                _flush()  # here, so that Python can't fail to write at its exit
    except FlockError as error:
        return _ended(f"error: {error}", error.exit_status)
    except KeyboardInterrupt as error:
        return _ended("stopped", error.status if isinstance(error, Ended) else INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output has closed it: no more output is possible.
        _forget_output()
        return BROKEN_PIPE
    except Exception as error:
        if isinstance(error, OSError) and (failure := disk_failure(error)):
            return _ended(f"error: {failure}", failure.exit_status)
        if os.environ.get(TRACEBACK):
            raise
        return _ended(f"error: {fault(error)}", FAULT)


def _ended(line: str, status: int) -> int:
    """Print the last line of a tool. Return its exit status, also if the line can't be printed."""
    try:
        note(line)
    except BrokenPipeError:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    return status


def _flush() -> None:
    """Flush the buffer of stdout. Raises RunFailed if it can't be written."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise _output_failed(error) from None


def _output_failed(error: OSError) -> RunFailed:
    """Return the error of stdout, and drop its buffer."""
    _forget_output()
    return RunFailed(f"standard output can't be written: {error.strerror}")


def _forget_output() -> None:
    """Drop the buffer of stdout: Python would try to write it again at its exit."""
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115
