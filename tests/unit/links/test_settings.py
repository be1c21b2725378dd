# SPDX-License-Identifier: Apache-2.0
"""Links are set as written. Impossible settings are refused in one line with a remedy."""

from __future__ import annotations

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.links.exchange_schedule import ExchangeSchedule
from flock_sim.links.keys import DELAY, DROP, RANGE, SEED, SPEED_NOISE
from flock_sim.links.registry import MODELS
from flock_sim.messages.handshake import check_handshake, handshake


def link_table(*links: str, birds: int = 13, coupling: str = "nearest"):
    return FlockConfiguration(birds=birds, coupling=coupling, links=links).link_table


# links -> words of the message: the value, the range, the fix
REFUSED = [
    (
        ["hodl:delay=1"],
        ["'hodl:delay=1'", "unknown model 'hodl'", "did you mean 'hold'?", "linear"],
    ),
    ([":delay=1"], ["unknown model ''", "known are exact, hold, linear"]),
    (["hold:dealy=1"], ["unknown key 'dealy'", "did you mean 'delay'?", "interval"]),
    (["hold:loss=0.1"], ["unknown key 'loss'", "did you mean 'drop'?"]),
    (["3:4=hodl"], ["unknown model 'hodl'", "did you mean 'hold'?"]),
    (["3:5=hold"], ["'3->5=hold'", "bird 5 does not feel bird 3"]),
    (["3:=hold"], ["unknown model '3'"]),
    (["hold:delay=1,"], ["unknown key ''", "known are"]),
    (["hold:delay=1;drop=0"], ["delay=1;drop=0", "whole number"]),
    (["hold:delay=1,delay=2"], ["delay is given twice", "leave one out"]),
    (["hold:noise=1,speed_noise=2"], ["speed_noise is given twice"]),
    (["hold:delay=-1"], ["delay=-1", "whole number of steps, 0..10000"]),
    (["hold:delay=1.5"], ["delay=1.5", "whole number"]),
    (["hold:delay=20000"], ["delay=20000", "0..10000"]),
    (["hold:delay="], ["delay= must be", "whole number"]),
    (["hold:delay"], ["delay= must be", "whole number"]),
    (["hold:delay=nan"], ["delay=nan", "whole number"]),
    (["hold:jitter=-2"], ["jitter=-2", "0..10000"]),
    (["hold:drop=1"], ["drop=1", "[0, 1)"]),
    (["hold:drop=-0.1"], ["drop=-0.1", "[0, 1)"]),
    (["hold:drop=0.1/1.5"], ["drop=1.5", "[0, 1)"]),
    (["hold:noise=-1"], ["noise=-1", "finite, 0 or more"]),
    (["hold:position_noise=inf"], ["position_noise=inf", "finite"]),
    (["hold:quantum=-0.5"], ["quantum=-0.5", "0 or more"]),
    (["hold:range=0"], ["range=0", "above 0"]),
    (["hold:timeout=-1"], ["timeout=-1", "0 or more, or inf"]),
    (["hold:timeout=2.5"], ["timeout=2.5", "whole number"]),
    (["hold:seed=-1"], ["seed=-1", "0..2^53"]),
    (["hold:seed=0.5"], ["seed=0.5", "whole number"]),
    (["hold:interval=0"], ["interval=0", "1 or more"]),
    (["hold:interval=2.5"], ["interval=2.5", "whole number"]),
    (["hold:interval=inf"], ["interval=inf", "whole number"]),
    (["hold:interval=1/2"], ["one interval"]),
    (["exact:interval=2"], ["exact", "every stage", "leave interval out", "hold or linear"]),
    (["hold:delay=1/2/3,drop=0/0.1"], ["drop has 2 values and delay 3", "1 or 3"]),
    (["hold:delay=1/2", "2->3=hold:delay=1/2/3"], ["has 2 members", "has 3", "1 or 3"]),
    (["3->5=hold"], ["'3->5=hold'", "bird 5 does not feel bird 3", "it feels 4, 6"]),
    (["3->3=hold"], ["bird 3 does not feel bird 3"]),
    (["13->14=hold"], ["bird 14 is not among 1..13"]),
    (["0->1=hold"], ["bird 0 is not among 1..13"]),
    (["3->4"], ["'3->4'", "SOURCE:TARGET", "3:4=linear"]),
    (["3->=hold"], ["'3->=hold'", "SOURCE:TARGET"]),
    (["a->b=hold"], ["'a->b=hold'", "SOURCE:TARGET"]),
    (["3->4=hodl"], ["unknown model 'hodl'", "did you mean 'hold'?"]),
]


@pytest.mark.parametrize(("links", "words"), REFUSED)
def test_a_link_that_can_not_be_is_refused_in_one_line(links, words):
    with pytest.raises(FlockError) as caught:
        FlockConfiguration.from_parameters({"links": links})
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    for word in (*words, links[0].partition(":")[0]):
        assert word in message, message


def test_members_of_links_and_span_ratios_must_be_as_many():
    with pytest.raises(FlockError, match=r"has 2 members and span_ratios have 3: give 1 or 3"):
        FlockConfiguration(span_ratios=("4=0.9,1,1.1",), links=("hold:delay=1/2",))


def test_links_make_members_as_span_ratios_do():
    configuration = FlockConfiguration(span_ratios=("4=0.9",), links=("hold:delay=1/2/3",))
    assert configuration.members == 3
    assert np.array_equal(configuration.span_ratio[3], [0.9] * 3)


def test_later_entries_win_for_their_links():
    all_links = link_table("3->4=linear", "hold:interval=4", "4->3=linear:interval=2")
    assert MODELS[all_links.of(3, 4).model].name == "hold"
    assert MODELS[all_links.of(4, 3).model].name == "linear"
    assert all_links.of(4, 3).interval == 2
    assert all_links.exchange_schedule == ExchangeSchedule(False, (2, 4))


def test_noise_and_quantum_set_position_and_speed():
    both = link_table("hold:noise=0.1,quantum=0.01").of(1, 2)
    each = link_table(
        "hold:position_noise=0.1,speed_noise=0.1,position_quantum=0.01,speed_quantum=0.01"
    ).of(1, 2)
    assert np.array_equal(both.faults, each.faults)
    assert both.faults[SPEED_NOISE] == 0.1


def test_values_are_those_of_the_members():
    plan = link_table("hold:delay=1/2,drop=0.25,range=4/inf,seed=1e3").plan([2], 2)
    assert plan.faults[:, DELAY].tolist() == [[1.0, 2.0]] * 2
    assert plan.faults[:, DROP].tolist() == [[0.25, 0.25]] * 2
    assert plan.faults[:, RANGE].tolist() == [[4.0, np.inf]] * 2
    assert plan.faults[:, SEED].tolist() == [[1000.0, 1000.0]] * 2


def test_exchanges_are_at_multiples_of_all_intervals():
    exchange_schedule = ExchangeSchedule(False, (4, 6))
    due = [tick for tick in range(100) if exchange_schedule.due(tick)]
    assert due == [4 * step for step in (0, 4, 6, 8, 12, 16, 18, 20, 24)]
    assert [exchange_schedule.after(tick) for tick in (-1, *due[:-1])] == due
    assert exchange_schedule.after(17) == 24
    assert exchange_schedule.exchanges(4, 12) == 3
    assert ExchangeSchedule().exchanges(4, 12) == 32


def test_a_flock_with_any_exact_link_exchanges_every_stage():
    assert link_table("hold", "3->4=exact").exchange_schedule.every_tick
    assert not link_table("hold").exchange_schedule.every_tick
    # All links there are, one by one: those that are set for all are then nobody's.
    assert not link_table("exact", "1->2=hold", "2->1=hold", birds=2).exchange_schedule.every_tick
    assert link_table("hold", birds=1).plain


def test_memories_lie_in_a_row_by_bird():
    mixed = link_table("1->2=hold", "3->2=linear:interval=2,delay=3", "2->3=exact:delay=1", birds=3)
    # Latest and on their way: 2 and 3 at one stage, and 3 at four; five numbers each.
    assert mixed.memory_ends.tolist() == [0, 0, 25, 25 + 60]
    assert [mixed.remembers(bird) for bird in (1, 2, 3)] == [0, 25, 60]


def test_who_flies_over_other_links_does_not_agree():
    configuration = FlockConfiguration(links=("hold:interval=10",))
    check_handshake("bird_01", configuration, handshake(configuration))
    with pytest.raises(FlockError, match=r'bird_01 has links = \["hold:interval=10"\]'):
        check_handshake("bird_01", configuration, handshake(FlockConfiguration()))


@pytest.mark.parametrize("entry", ["3:4=hold:delay=2", " 3 : 4=hold:delay=2", "03:4=hold:delay=2"])
def test_birds_may_be_written_so_that_a_shell_leaves_them_alone(entry):
    flock = FlockConfiguration(links=(entry, "linear:delay=1"))
    assert flock.links == ("3->4=hold:delay=2", "linear:delay=1")
    assert flock == FlockConfiguration.from_parameters({"links": [entry, "linear:delay=1"]})
