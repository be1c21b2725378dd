# SPDX-License-Identifier: Apache-2.0
"""The limits that `limits` prints, as JSON and as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from flock_sim.analysis.metrics import STABLE_BELOW
from flock_sim.theory.limit_search import NO_GAP, End, Limits


class _Words(NamedTuple):
    """How the modified quantity is called."""

    modified: str
    ratios: str
    value: str
    present: str


WORDS = {
    "span": _Words("one modified", "the span ratios", "span ratio", "its ratios"),
    "thrust": _Words("the thrust of one changed", "the ratios T/T_0", "thrust", "T_0"),
}


def as_json(limits: Limits, tried: bool) -> dict[str, Any]:
    """Return the limits of one bird. With `tried`, include the verdict on each tried span ratio."""
    facts: dict[str, Any] = {"bird": limits.bird}
    for side, end in (("lower", limits.lower), ("upper", limits.upper)):
        facts[side] = end and end.ratio
        facts[f"{side}_gap"] = end and end.gap
        facts[f"{side}_parts"] = end and end.parts
    facts["never"] = limits.never
    facts["searched"] = limits.searched and list(limits.searched)
    if tried:
        facts["tried"] = [
            {"span_ratio": ratio, "holds": gap == 0, "gap": None if gap in (0, NO_GAP) else gap}
            for ratio, gap in limits.tried
        ]
    return facts


def described(found: Sequence[Limits], facts: dict[str, Any]) -> str:
    """Return the limits as text."""
    low, high = facts["between"]
    words = WORDS[facts["of"]]
    lines = [
        f"{facts['birds']} birds, {facts['coupling']} coupling, {words.modified}: {words.ratios} "
        f"from {low:g} to {high:g} that keep the formation",
    ]
    digits = 12 if facts["method"] == "exact" else 2 - round(math.log10(facts["resolution"]))
    width = digits + 3
    lines.append(f"  bird   {'lower':<{width}}  opens   {'upper':<{width}}  opens")
    for limits in found:
        searched = limits.searched
        if limits.never or searched is None:
            lines.append(f"  {limits.bird:4}   none: no such {words.value} of this bird was found")
            continue
        ends = [
            f"{end.ratio:<{width}.{digits}f}  {_opens(end):<5}"
            if end
            else f"{f'{side} {edge:.9g}':<{width}}  {'':<5}"
            for end, side, edge in (
                (limits.lower, "below", searched[0]),
                (limits.upper, "above", searched[1]),
            )
        ]
        lines.append(f"  {limits.bird:4}   {'   '.join(ends)}")
    lines += [_shortened(limits, high) for limits in found if _is_shortened(limits, low)]
    if facts["of"] == "thrust":
        lines += [_gliding(limits.bird) for limits in found if _can_glide(limits)]
    if not facts["as_given"]:
        lines.append(
            "the flock as given can't fly in formation: intervals are those nearest to "
            f"{words.present}"
            if facts["method"] == "exact"
            else f"the flock as given has sigma_U >= {STABLE_BELOW:g} at t = {facts['t_max']:g}: "
            "intervals are those nearest to its ratios; it may settle in a longer flight (--t-max)"
        )
    lines += _how(facts)
    return "\n".join(line.rstrip() for line in lines)


def _is_shortened(limits: Limits, low: float) -> bool:
    return limits.searched is None or limits.searched[0] > low


def _can_glide(limits: Limits) -> bool:
    """Return whether the interval of a bird's thrust reaches down to 0."""
    return bool(limits.searched and limits.searched[0] == 0.0 and not limits.lower) and (
        not limits.never
    )


def _gliding(bird: int) -> str:
    return f"bird {bird}: keeps the formation without any thrust"


def _shortened(limits: Limits, high: float) -> str:
    """Return the line on a bird whose search did not begin at the requested ratio."""
    if limits.searched is None:
        return f"bird {limits.bird}: nothing is searched: up to {high:g}, vortices would meet"
    first = limits.searched[0]
    return f"bird {limits.bird}: searched from {first:.9g}: below it, vortices would meet"


def _how(facts: dict[str, Any]) -> list[str]:
    """Return the lines on how the limits were found."""
    if facts["method"] == "exact":
        return [f"computed in {facts['seconds']:.3f} s"]
    done = (
        f"to t = {facts['t_max']:g} in steps of {facts['dt']:g}: "
        f"{facts['member_steps']:,} member-steps in {facts['seconds']:.1f} s, "
        f"{facts['member_steps_per_second']:,.0f} a second"
    )
    if facts["method"] == "integrate":
        return [f"flown {done}, {facts['workers']} workers"]
    lines = [
        f"flown over ROS 2 by {facts['birds']} birds in {facts['processes']} processes, "
        f"{facts['members']} members at once,",
        f"{done} ({facts['start_seconds']:.1f} s of them to start)",
    ]
    return [*lines, f"bag:   {facts['bag']}"] if facts["bag"] else lines


def _opens(end: End) -> str:
    return f"gap {end.gap}" if end.gap else "none"
