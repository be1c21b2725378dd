# SPDX-License-Identifier: Apache-2.0
"""`limits` prints the specified output, by either method and on either kind of workers."""

from pathlib import Path

import numpy as np
import pytest

from flock_tools.commands.limits import tool
from flock_tools.experiments import workers
from support.tool_runs import error_of, json_of, text_of


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_json_is_the_contract(coupling: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = json_of(tool, capsys, "--birds", "7", "--coupling", coupling)
    assert (result["birds"], result["coupling"], result["method"]) == (7, coupling, "exact")
    assert [limit["bird"] for limit in result["limits"]] == [1, 2, 3, 4]
    for limit in result["limits"]:
        assert limit.keys() >= {"bird", "lower", "upper", "lower_gap", "upper_gap"}
        assert 0.5 < limit["lower"] < 1.0 < limit["upper"] < 1.5
        assert {limit["lower_gap"], limit["upper_gap"]} <= set(range(1, 7))


def test_integrating_finds_the_exact_limits_to_its_resolution(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # Five birds settle by t = 2e4: e-folding takes some 1.6e3, ten of which take the start's spread
    # of 0.1 below 1e-5. Near a limit a flock escapes, or settles, ever more slowly: that widens the
    # comparison, by some 1e-3 as docs/results.md shows, to either side.
    exact = json_of(tool, capsys, "--birds", "5")
    flown = json_of(
        tool,
        capsys,
        "--birds",
        "5",
        "--method",
        "integrate",
        "--t-max",
        "2e4",
        "--resolution",
        "2e-3",
    )
    assert flown["member_steps"] >= 3 * 3 * 20000
    rate = flown["member_steps"] / flown["seconds"]
    assert flown["member_steps_per_second"] == pytest.approx(rate, rel=1e-12)
    for one, other in zip(exact["limits"], flown["limits"], strict=True):
        assert other["lower"] == pytest.approx(one["lower"], abs=4e-3)
        assert other["upper"] == pytest.approx(one["upper"], abs=4e-3)
        assert other["lower_gap"] == one["lower_gap"]


@pytest.mark.parametrize("method", ["exact", "integrate"])
def test_limits_are_those_of_a_flock_that_nobody_pushes(
    method: str, capsys: pytest.CaptureFixture[str]
) -> None:
    # The push, ten steps before the end, would leave no flock with sigma_U < 1e-4.
    flock = ("--birds", "3", "--method", method, "--bird", "2")
    push = ("--perturb", "1@9990=0,0.1")
    calm = json_of(tool, capsys, *flock)
    unused = "note: --perturb: no effect on the result of this tool\n"
    pushed = json_of(tool, capsys, *flock, *push, notes=unused)
    assert pushed["limits"] == calm["limits"]
    assert not calm["limits"][0]["never"]


def test_exact_limits_do_not_depend_on_the_time_of_flight(
    capsys: pytest.CaptureFixture[str],
) -> None:
    flock = ("--birds", "3", "--bird", "2")
    notes = "note: --dt, --t-max: no effect on the result of this tool\n"
    timed = json_of(tool, capsys, *flock, "--t-max", "10", "--dt", "0.5", notes=notes)
    assert timed["limits"] == json_of(tool, capsys, *flock)["limits"]


@pytest.mark.slow
def test_a_dask_cluster_finds_what_this_machine_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from distributed import LocalCluster

    arguments = ("--birds", "3", "--method", "integrate", "--t-max", "1e4", "--bird", "2,3")
    here = json_of(tool, capsys, *arguments)
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        local_directory=str(tmp_path),
    ) as cluster:
        there = json_of(tool, capsys, *arguments, "--scheduler", cluster.scheduler_address)
    assert there["workers"] == 2
    assert there["limits"] == here["limits"]
    assert there["member_steps"] == here["member_steps"]


def test_an_interval_without_a_limit_is_told_plainly(capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of(tool, capsys, "--birds", "3", "--between", "0.9,1.05", "--bird", "2")
    assert "below 0.9" in text
    assert "above 1.05" in text
    inside = json_of(tool, capsys, "--birds", "3", "--between", "0.9,1.05", "--bird", "2")[
        "limits"
    ][0]
    assert (inside["lower"], inside["upper"], inside["never"]) == (None, None, False)


def test_a_search_that_begins_where_vortices_meet_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flock = ("--birds", "2", "--span-ratio", "1=0.5", "--bird", "2", "--between", "0.2,0.503")
    picture = ("--output", str(tmp_path / "limits.png"))
    text = text_of(tool, capsys, *flock, *picture)
    assert "below 0.500001 " in text
    assert "bird 2: searched from 0.500001: below it, vortices would meet" in text
    assert "below 0.2" not in text
    found = json_of(tool, capsys, *flock)["limits"][0]
    assert found["lower"] is None
    assert found["searched"] == [pytest.approx(0.500001, abs=1e-12), 0.503]
    nothing = ("--birds", "2", "--span-ratio", "1=0.5", "--bird", "2", "--between", "0.2,0.4")
    assert "bird 2: nothing is searched" in text_of(tool, capsys, *nothing)
    assert json_of(tool, capsys, *nothing)["limits"][0]["searched"] is None


def test_a_flock_that_never_flies_is_told_plainly(capsys: pytest.CaptureFixture[str]) -> None:
    flock = ("--birds", "5", "--span-ratio", "2=0.8", "--bird", "1,5")
    text = text_of(tool, capsys, *flock)
    assert "none: no such span ratio of this bird was found" in text
    assert "the flock as given can't fly in formation" in text
    result = json_of(tool, capsys, *flock)
    assert [limit["never"] for limit in result["limits"]] == [True, True]
    assert not result["as_given"]


def test_the_flock_as_given_is_judged_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    # Not by whether its own span ratio lies in the interval that was searched.
    for method in ("exact", "integrate"):
        flown = ("--method", method, "--t-max", "2e4") if method == "integrate" else ()
        found = json_of(tool, capsys, "--birds", "3", "--bird", "1", "--between", "1.2,1.3", *flown)
        assert found["as_given"]
        assert found["limits"][0]["never"]
    small = ("--birds", "3", "--span-ratio", "1=0.8", "--bird", "1", "--between", "0.95,1.05")
    found = json_of(tool, capsys, *small)
    assert not found["as_given"]
    assert (found["limits"][0]["lower"], found["limits"][0]["upper"]) == (None, None)
    assert not found["limits"][0]["never"]


def test_both_wings_are_searched_where_they_differ(capsys: pytest.CaptureFixture[str]) -> None:
    result = json_of(tool, capsys, "--birds", "5", "--span-ratio", "2=1.01")
    assert [limit["bird"] for limit in result["limits"]] == [1, 2, 3, 4, 5]
    # Bird 2's own limits do not depend on what it is now.
    same = json_of(tool, capsys, "--birds", "5", "--bird", "2")["limits"][0]
    np.testing.assert_allclose(
        [result["limits"][1]["lower"], result["limits"][1]["upper"]],
        [same["lower"], same["upper"]],
        rtol=0.0,
        atol=1e-12,  # two bisections to 1e-13
    )


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_limits_of_thrust_have_the_same_json(
    coupling: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flock = ("--birds", "7", "--coupling", coupling)
    span = json_of(tool, capsys, *flock)
    thrust = json_of(tool, capsys, *flock, "--of", "thrust")
    assert thrust.keys() == span.keys()
    assert (span["of"], thrust["of"], thrust["between"]) == ("span", "thrust", [0.0, 2.0])
    for one, other in zip(span["limits"], thrust["limits"], strict=True):
        assert one.keys() == other.keys()
        assert 0.7 < other["lower"] < 1.0 < other["upper"] < 1.2


def test_limits_of_thrust_are_told_plainly(capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of(tool, capsys, "--birds", "3", "--of", "thrust")
    assert "the thrust of one changed: the ratios T/T_0 from 0 to 2 that keep the" in text
    assert "     1   0.919506316829   gap 1   1.141788600378   gap 1" in text
    small = ("--birds", "3", "--span-ratio", "2=0.2", "--of", "thrust")
    text = text_of(tool, capsys, *small)
    assert "bird 2: keeps the formation without any thrust" in text
    assert "bird 1: keeps" not in text
    assert "without any thrust" not in text_of(tool, capsys, *small, "--between", "0.1,2")
    never = ("--birds", "5", "--span-ratio", "2=0.6", "--of", "thrust", "--bird", "1,4")
    text = text_of(tool, capsys, *never)
    assert "none: no such thrust of this bird was found" in text
    assert "intervals are those nearest to T_0" in text


def test_the_diagram_of_thrust_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "thrust.svg"
    small = ("--birds", "3", "--span-ratio", "2=0.2", "--of", "thrust", "--between", "0,20")
    text_of(tool, capsys, *small, "--output", str(output))
    assert output.stat().st_size > 1000


@pytest.mark.parametrize("method", ["integrate", "fly"])
def test_limits_of_thrust_are_exact_only(method: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = error_of(tool, capsys, "--of", "thrust", "--method", method)
    assert f"--method {method} is for --of span" in line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--of thrst", "did you mean 'thrust'"),
        ("--between -0.1,2", "--between -0.1,2: must be two ratios T/T_0 LO,HI with 0 <= LO < HI"),
        ("--between 1,1", "such as 0,2"),
        ("--between 0,inf", "--between 0,inf: must be"),
        ("--between nan,1", "--between nan,1: must be"),
        ("--points 5", "--points is for --method integrate and fly"),
        ("--bird 0", "--bird 0: must be a whole number, 1..13"),
        ("--birds 1", "must be 2 or more, since limits need a formation"),
    ],
)
def test_bad_input_for_limits_of_thrust_is_one_line(
    arguments: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    option, value = arguments.split()
    of = () if option == "--of" else ("--of", "thrust")
    assert words in error_of(tool, capsys, *of, f"{option}={value}")


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_diagram_is_drawn(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / f"limits.{kind}"
    text = text_of(tool, capsys, "--birds", "5", "--output", str(output))
    assert f"drawn: {output}" in text
    assert output.stat().st_size > 1000


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "must be 2 or more, since limits need a formation" in error_of(
        tool, capsys, "--birds", "1"
    )
    assert "give one span ratio" in error_of(tool, capsys, "--span-ratio", "3=0.9,1.0")
    assert "--between 1.5,0.5" in error_of(tool, capsys, "--between", "1.5,0.5")
    assert "did you mean 'exact'" in error_of(tool, capsys, "--method", "exakt")
    assert "--bird 14: must be a whole number, 1..13" in error_of(tool, capsys, "--bird", "14")
    assert "for --method integrate" in error_of(tool, capsys, "--resolution", "1e-3")
    assert "--bird : must be" in error_of(tool, capsys, "--bird", "1,,2")
    assert "in --bird 1,,2" in error_of(tool, capsys, "--bird", "1,,2")
    assert "--resolution 0" in error_of(tool, capsys, "--method", "integrate", "--resolution", "0")
    assert "--points 1: must be" in error_of(tool, capsys, "--method", "integrate", "--points", "1")
    assert "and fly: leave it out" in error_of(tool, capsys, "--points", "5")
    nothing = tmp_path / "limits.txt"
    assert "must end in one of" in error_of(tool, capsys, "--birds", "3", "--output", str(nothing))
    assert not nothing.exists()
    missing = tmp_path / "missing" / "limits.png"
    assert "can't be written" in error_of(tool, capsys, "--birds", "3", "--output", str(missing))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--processes 0", "--processes 0: must be a whole number, 1..5"),
        ("--processes 6", "--processes 6: must be a whole number, 1..5"),
        ("--timeout 0", "--timeout 0: must be a finite number above 0"),
        ("--t-max -5", "t_max = -5: must be finite and above 0"),
        ("--points x", "--points x: must be a whole number, 2..1001"),
        ("--resolution 0.1", "--resolution is for --method integrate"),
        ("--scheduler tcp://127.0.0.1:9", "--scheduler is for --method integrate"),
        ("--bag .", "--bag . exists"),
        ("--method flies", "did you mean 'fly'"),
    ],
)
def test_what_can_not_be_flown_is_one_line(
    arguments: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = ("--method", "fly", "--birds", "5")
    assert words in error_of(tool, capsys, *flight, *arguments.split())
    if arguments.startswith("--processes"):
        integrate = ("--method", "integrate", *arguments.split())
        assert "--processes is for --method fly" in error_of(tool, capsys, *integrate)


def test_a_finer_grid_is_where_integrating_begins(capsys: pytest.CaptureFixture[str]) -> None:
    flock = ("--birds", "2", "--bird", "1", "--method", "integrate", "--t-max", "1e4")
    found = json_of(tool, capsys, *flock, "--points", "6", "--resolution", "0.5")["limits"][0]
    ratios = [tried["span_ratio"] for tried in found["tried"]]
    assert ratios == pytest.approx([0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 1.5])
    held = [tried["span_ratio"] for tried in found["tried"] if tried["holds"]]
    assert min(held) > found["lower"] > max(r for r in ratios if r < min(held))
    assert max(held) < found["upper"] < min(r for r in ratios if r > max(held))


def test_a_scheduler_that_does_not_answer_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "TIMEOUT", 0.5)
    # Nobody listens on the port of `discard`; a connection is refused at once.
    line = error_of(tool, capsys, "--method", "integrate", "--scheduler", "tcp://127.0.0.1:9")
    assert "no Dask scheduler answers there" in line


@pytest.mark.parametrize("address", ["nowhere", "", "foo://127.0.0.1:1", "tcp://127.0.0.1"])
def test_what_is_no_address_is_one_line(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = error_of(tool, capsys, "--method", "integrate", "--scheduler", address)
    assert "must be an address such as tcp://127.0.0.1:8786" in line


@pytest.mark.parametrize("method", ["exact", "integrate"])
def test_limits_over_links_that_are_not_exact_are_refused(
    method: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flock = ("--birds", "3", "--method", method)
    error = error_of(tool, capsys, *flock, "--link", "hold:interval=5")
    assert "links hold:interval=5: limits solves the exact coupling" in error
    if method == "exact":
        calm, exact = (json_of(tool, capsys, *flock, *k) for k in ((), ("--link", "exact")))
        assert exact["limits"] == calm["limits"]
