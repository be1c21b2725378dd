# SPDX-License-Identifier: Apache-2.0
"""The output of libraries does not mix with results on stdout."""

import os
import subprocess
import sys

import pytest

from flock_sim.console.stdout import results_only_on_stdout


def test_what_a_library_or_a_child_prints_is_no_result(capfd: pytest.CaptureFixture[str]) -> None:
    print("one")
    with results_only_on_stdout():
        os.write(1, b"a library\n")
        subprocess.run([sys.executable, "-c", "print('a child')"], check=True)
    print("two")
    said = capfd.readouterr()
    assert (said.out, said.err) == ("one\ntwo\n", "a library\na child\n")


def test_stdout_is_back_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ZeroDivisionError), results_only_on_stdout():
        raise ZeroDivisionError
    print("a result")
    assert capfd.readouterr().out == "a result\n"
