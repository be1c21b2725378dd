# SPDX-License-Identifier: Apache-2.0
"""Every tool ends with an exit status and an error line that helps its user."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence

import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.options import add_flock_options, flock_configuration
from flock_sim.console.arguments import Parser, positive_number, print_json, run_tool, whole_number
from flock_sim.errors import FlockError, RunFailed


def raising(error: BaseException) -> int:
    def tool(arguments: Sequence[str]) -> int:
        raise error

    return run_tool(tool, [])


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (FlockError("birds = 0: must be 1 or more"), 2, "error: birds = 0: must be 1 or more\n"),
        (RunFailed("the recorder is gone"), 1, "error: the recorder is gone\n"),
        (KeyboardInterrupt(), 130, "stopped\n"),
    ],
)
def test_what_ends_a_tool_is_one_line_and_a_status(
    error: BaseException, status: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert raising(error) == status
    assert capsys.readouterr() == ("", line)


def test_the_answer_of_a_tool_is_its_status() -> None:
    assert run_tool(lambda arguments: len(arguments), ["one"]) == 1
    assert run_tool(lambda arguments: len(arguments), []) == 0


def test_arguments_come_from_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["tool", "a", "b"])
    assert run_tool(lambda arguments: len(arguments)) == 2


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (ZeroDivisionError("division by zero"), "ZeroDivisionError: division by zero, at "),
        (MemoryError(), "MemoryError, at "),
        (RecursionError("too deep"), "RecursionError: too deep, at "),
        (OSError(22, "Invalid argument", "a\x1b.yaml"), r"(file a\x1b.yaml), at "),
        (KeyError("\x1b]0;x\x07" + "k" * 5000), "KeyError: '"),
    ],
    ids=lambda case: type(case).__name__,
)
def test_a_fault_of_flock_is_one_line_and_has_its_own_status(
    error: Exception,
    kind: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("FLOCK_TRACEBACK")
    assert raising(error) == 70
    line = capsys.readouterr().err
    assert line.startswith("error: a fault of Flock: ")
    assert kind in line
    assert re.search(r", at unit/console/test_arguments\.py:\d+ in tool; ", line)
    assert "FLOCK_TRACEBACK=1" in line
    assert line[:-1].isprintable()
    assert len(line) < 400


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(5, "Input/output error", "a\x1b"), r"a\\x1b .*\(Input/.*\): check the disk"),
        (OSError(28, "No space left on device"), r"a file .*\(No space .*\): free disk space"),
        (OSError(24, "Too many open files", "x"), r"x can't be .*open files\): allow more open"),
    ],
)
def test_a_disk_that_fails_is_no_fault_of_flock(
    error: OSError, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert raising(error) == 1
    assert re.fullmatch(f"error: {words}.*\n", capsys.readouterr().err)


def test_a_fault_of_flock_is_raised_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FLOCK_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        raising(ZeroDivisionError())


def flock(*arguments: str) -> FlockConfiguration:
    parser = Parser("fly", "Fly.", "")
    add_flock_options(parser)
    return flock_configuration(parser.parse_args(arguments))


def test_no_options_are_the_defaults() -> None:
    assert flock() == FlockConfiguration()


def test_every_option_reaches_the_configuration() -> None:
    flight = ("--dt", "0.5", "--t-max", "1e2", "--record-every", "4")
    spans = ("--span-ratio", "1=0.9", "--span-ratio", "2=1,1.1")
    pushes = ("--perturb", "4@150=-0.1", "--perturb", "1:2@0=0,0.01")
    assert flock("--birds", "5", "--coupling", "all", *flight, *spans, *pushes) == (
        FlockConfiguration(
            5,
            "all",
            0.5,
            100.0,
            4,
            span_ratios=("1=0.9", "2=1,1.1"),
            perturbations=("4@150=-0.1", "1:2@0=0,0.01"),
        )
    )


def test_options_are_not_abbreviated() -> None:
    with pytest.raises(FlockError, match="--bird"):
        flock("--bird", "3")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--brids", "3"), "unrecognized arguments: --brids 3, did you mean --birds?; ./flock fly"),
        (("--tmax=3",), "unrecognized arguments: --tmax=3, did you mean --t-max?"),
        (("x", "--links", "hold"), "unrecognized arguments: x --links hold, did you mean --link?"),
        (("x",), "unrecognized arguments: x; ./flock fly --help"),
        (("--zzzz",), "unrecognized arguments: --zzzz; ./flock fly --help"),
        (("--coupling", "all-to-all"), "'all-to-all': did you mean 'all'?"),
        (("--coupling", "neighbour"), "'neighbour': known are nearest, all"),
    ],
)
def test_a_word_that_is_nearly_right_is_corrected(arguments: tuple[str, ...], words: str) -> None:
    with pytest.raises(FlockError) as refused:
        flock(*arguments)
    assert words in str(refused.value)


@pytest.mark.parametrize("number", ["1e4", "1E+4", "10000", "1_0000.0"])
def test_numbers_are_taken_in_any_usual_form(number: str) -> None:
    assert flock("--t-max", number).t_max == 1e4
    assert flock("--birds", "1e1").birds == 10


def test_whole_numbers_keep_their_bounds() -> None:
    assert whole_number("--processes", "3", 1, 3) == 3
    assert whole_number("--window", "64", 1) == 64
    for text in ("0", "4", "-1", "2.5", "nan", "", "three"):
        with pytest.raises(FlockError, match=rf"--processes {text}: .*1\.\.3"):
            whole_number("--processes", text, 1, 3)
    with pytest.raises(FlockError, match="1 or more"):
        whole_number("--window", "0", 1)


@pytest.mark.parametrize("text", ["9" * 20, "9" * 5000, "-" + "9" * 5000, "1e400", "x" * 5000])
def test_what_is_beyond_all_bounds_is_refused_in_a_line_that_can_be_read(text: str) -> None:
    readers = (lambda: whole_number("--window", text, 1), lambda: positive_number("--rate", text))
    for read in readers:
        with pytest.raises(FlockError) as refused:
            read()
        assert len(str(refused.value)) < 160


def test_positive_numbers_are_finite() -> None:
    assert positive_number("--timeout", "2.5e1") == 25.0
    for text in ("0", "-1", "nan", "inf", "", "long"):
        with pytest.raises(FlockError, match=f"--timeout {text}: .*finite number above 0"):
            positive_number("--timeout", text)


def test_json_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": [1.5, None], "b": "ü"})
    printed = capsys.readouterr().out
    assert printed.count("\n") == 1
    assert json.loads(printed) == {"a": [1.5, None], "b": "ü"}
