# SPDX-License-Identifier: Apache-2.0
"""A perturbation changes the given bird at the given step as stated, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, in_order, perturbations
from flock_sim.errors import FlockError
from flock_sim.messages.state import ARRAYS
from flock_sim.reference.integrator import Reference

BIRDS, STEPS = 4, 60
FLOWN = FlockConfiguration(
    birds=BIRDS, t_max=float(STEPS), record_every=7, span_ratios=("2=0.97,1.0,1.04",)
)
MEMBERS = FLOWN.members

change = st.floats(-0.1, 0.1)
pushes = st.builds(
    Perturbation,
    step=st.integers(0, STEPS),
    bird=st.integers(1, BIRDS),
    member=st.integers(1, MEMBERS),
    position=change,
    speed=change,
)


def flown(given: list[Perturbation], configuration: FlockConfiguration = FLOWN) -> bytes:
    """Every bit that is recorded of a flight with these perturbations."""
    flight = Reference(replace(configuration, perturbations=tuple(map(str, given))))
    return recorded(flight)


def recorded(flight: Reference) -> bytes:
    return b"".join(getattr(state, name).tobytes() for state in flight.fly() for name in ARRAYS)


# --- as text ---


@given(
    step=st.integers(0, 2**53),
    bird=st.integers(1, 20000),
    member=st.integers(1, 10**6),
    position=st.floats(allow_nan=False, allow_infinity=False),
    speed=st.floats(allow_nan=False, allow_infinity=False),
)
def test_what_is_written_is_read_back_to_the_bit(
    step: int, bird: int, member: int, position: float, speed: float
) -> None:
    written = Perturbation(step, bird, member, position, speed)
    (read,) = perturbations([str(written)], bird, member, step)
    assert read == written
    assert (str(read), read.position.hex(), read.speed.hex()) == (
        str(written), position.hex(), speed.hex(),
    )  # fmt: skip


@given(text=st.text("0123456789:@=,.-+enaif ", max_size=20))
def test_any_text_is_read_or_refused_in_one_line_that_names_it(text: str) -> None:
    told = ""
    try:
        read = perturbations([text], 9, 2, 99)
    except FlockError as error:
        told = str(error)
    if told:
        assert repr(text) in told
        assert "\n" not in told
        return
    assert read
    for push in read:
        push.check(9, 2, 99)


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("4@50=0.1,-0.01", (50, 4, 0.1, -0.01)),
        ("4@50=0.1", (50, 4, 0.1, 0.0)),
        ("4@5e1=-1e-3", (50, 4, -0.001, 0.0)),
        ("1@0=0,+.5", (0, 1, 0.0, 0.5)),
    ],
)
def test_all_members_are_pushed_where_none_is_named(
    text: str, read: tuple[int, int, float, float]
) -> None:
    step, bird, *by = read
    assert perturbations([text], 4, 3, 60) == tuple(
        Perturbation(step, bird, member, *by) for member in (1, 2, 3)
    )


def test_pushes_stay_in_the_order_in_which_they_were_given() -> None:
    read = perturbations(["2@9=1", "1:2@9=2", "2:1@3=3", "2:1@9=4"], 2, 2, 9)
    assert [push.position for push in read] == [1.0, 1.0, 2.0, 3.0, 4.0]
    assert [push.position for push in in_order(read)] == [3.0, 2.0, 1.0, 4.0, 1.0]


# --- in flight ---


@given(given=st.lists(pushes, max_size=6))
def test_a_flight_is_that_of_one_whose_birds_are_moved_by_hand(given: list[Perturbation]) -> None:
    by_hand = Reference(FLOWN)
    states = []
    for step in range(STEPS + 1):
        for push in given:  # in their order
            if push.step == step:
                at = push.bird - 1, push.member - 1
                by_hand.position[at] = by_hand.position[at] + push.position
                by_hand.speed[at] = by_hand.speed[at] + push.speed
        if step % FLOWN.record_every == 0:
            states.append(by_hand.observe().tobytes())
        if step < STEPS:
            by_hand.advance(1)
    assert flown(given) == b"".join(states)


@given(given=st.lists(pushes, min_size=1, max_size=4), live=st.integers(0, 4))
def test_pushes_asked_for_in_flight_come_after_those_of_the_configuration(
    given: list[Perturbation], live: int
) -> None:
    configured, later = given[:live], given[live:]
    configuration = replace(FLOWN, perturbations=tuple(map(str, configured)))
    assert recorded(Reference(configuration, live=later)) == flown(given)


def test_pushes_at_one_step_are_added_in_their_order() -> None:
    # x + 1e20 - 1e20 is 0, and x - 1e20 + 1e20 too; x + (1e20 - 1e20) would be x.
    flock = Reference(replace(FLOWN, perturbations=("1@0=1e20", "1@0=-1e20", "1@0=0.5")))
    assert flock.position[0].tolist() == [0.5, 0.5, 0.5]
    other = Reference(replace(FLOWN, perturbations=("1@0=0.5", "1@0=1e20", "1@0=-1e20")))
    assert other.position[0].tolist() == [0.0, 0.0, 0.0]


def test_pushes_asked_for_in_flight_are_added_last_at_their_step() -> None:
    # 0.5 is lost in 1e20 where it comes first, and left where it comes last.
    far = [Perturbation(0, 1, 1, change, 0.0) for change in (1e20, -1e20)]
    near = Perturbation(0, 1, 1, 0.5, 0.0)
    for configured, live, left in ((far, [near], 0.5), ([near], far, 0.0)):
        configuration = replace(FLOWN, perturbations=tuple(map(str, configured)))
        assert Reference(configuration, live=live).position[0, 0] == left


@given(step=st.integers(0, STEPS), bird=st.integers(1, BIRDS), zero=st.sampled_from(["0", "-0"]))
def test_a_push_of_zero_changes_no_bit(step: int, bird: int, zero: str) -> None:
    pushed = replace(FLOWN, perturbations=(f"{bird}@{step}={zero},{zero}",))
    assert recorded(Reference(pushed)) == flown([])


@pytest.mark.parametrize(
    "change", ["0.3,-0.02", "1e308,1e308", "-1e308", "0,-2", "0,-1.0277777777777777"]
)
@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_a_push_of_one_member_changes_no_bit_of_the_others(coupling: str, change: str) -> None:
    configuration = replace(FLOWN, coupling=coupling)
    entries = (f"3:2@0={change}", f"3:2@20={change}")
    whole = Reference(configuration).advance(STEPS)
    hurt = Reference(replace(configuration, perturbations=entries)).advance(STEPS)
    assert hurt[..., 1].tobytes() != whole[..., 1].tobytes()
    for member in (0, 2):
        assert hurt[..., member].tobytes() == whole[..., member].tobytes()


@pytest.mark.parametrize("step", [0, 14, STEPS - 4])
def test_the_state_recorded_at_that_step_is_the_one_after_the_push(step: int) -> None:
    configuration = replace(FLOWN, t_max=56.0)
    states = {
        pushes: {
            state.step: state
            for state in Reference(replace(configuration, perturbations=pushes)).fly()
        }
        for pushes in ((), (f"2:1@{step}=0.25,-0.125",))
    }
    without, pushed = states.values()
    for before in range(0, step, 7):
        assert pushed[before].position.tobytes() == without[before].position.tobytes()
    expected = without[step].position.copy(), without[step].speed.copy()
    expected[0][1, 0] += 0.25
    expected[1][1, 0] -= 0.125
    np.testing.assert_array_equal(pushed[step].position, expected[0])
    np.testing.assert_array_equal(pushed[step].speed, expected[1])
    # What is recorded of the forces is felt after it, too: Gamma U is a bird's own constant.
    np.testing.assert_allclose(
        pushed[step].circulation * pushed[step].speed,
        without[step].circulation * without[step].speed,
        rtol=2.0**-51,
    )
    assert pushed[step].interaction_drag[0, 0] != without[step].interaction_drag[0, 0]


@given(
    given=st.lists(pushes, max_size=4),
    cuts=st.lists(st.integers(0, STEPS), max_size=6).map(sorted),
    rows=st.integers(1, 12),
)
def test_it_makes_no_difference_in_how_many_pieces_a_flight_is_taken(
    given: list[Perturbation], cuts: list[int], rows: int
) -> None:
    whole = Reference(FLOWN, live=given).advance(STEPS)
    pieces = Reference(FLOWN, live=given)
    parts = [pieces.advance(cut - pieces.step) for cut in [*cuts, STEPS]]
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    states = [state.step for state in Reference(FLOWN, live=given).fly(rows)]
    assert states == list(range(0, STEPS + 1, FLOWN.record_every))


@given(begun=st.integers(0, STEPS))
def test_a_flight_goes_on_from_any_step(begun: int) -> None:
    flight = Reference(FLOWN)
    flight.advance(begun)
    for state, other in zip(
        flight.fly(), [s for s in Reference(FLOWN).fly() if s.step >= begun], strict=True
    ):
        assert state.step == other.step
        assert state.interaction_drag.tobytes() == other.interaction_drag.tobytes()


@pytest.mark.parametrize(
    "push",
    [
        Perturbation(STEPS + 1, 1, 1, 0.1, 0.0),
        Perturbation(0, BIRDS + 1, 1, 0.1, 0.0),
        Perturbation(0, 0, 1, 0.1, 0.0),
        Perturbation(0, 1, MEMBERS + 1, 0.1, 0.0),
        Perturbation(0, 1, 1, float("nan"), 0.0),
    ],
)
def test_a_live_push_of_what_is_not_there_is_refused(push: Perturbation) -> None:
    with pytest.raises(FlockError, match="perturbation"):
        Reference(FLOWN, live=[push])
