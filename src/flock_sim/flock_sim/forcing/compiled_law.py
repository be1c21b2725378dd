# SPDX-License-Identifier: Apache-2.0
"""The compilation of laws into functions that kernels call by their addresses.

A law is compiled into a loop over the members of a bird, which takes the words of
`forcing/frame.py`. The code of Flock's own laws is kept on disk, as that of kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from flock_sim.errors import FlockError
from flock_sim.forcing import frame
from flock_sim.forcing.law import GIVEN, Bird, Law, Neighbours, Signature, signature_of
from flock_sim.physics.compile import anew_for_kernels, kernel, plain_callees
from flock_sim.physics.compiler import numba
from flock_sim.physics.dynamics import canonical
from flock_sim.physics.kernel_cache import PACKAGE
from flock_sim.physics.native_call import ADDRESS, address_of, call_at
from flock_sim.physics.runge_kutta import NODES, STAGES

UnsupportedBytecodeError = numba.core.errors.UnsupportedBytecodeError

MOST_STATES = 16
"""Most numbers of state of a law."""

DIVERGED = 1e100
"""Values of a member from which on it has diverged."""

WITH_STATE = "(force, (rate of state[0], ...))"
"""What a law with a state returns, in words."""

_LOOP: Any = numba.types.none(ADDRESS, ADDRESS, ADDRESS, numba.types.float64)
"""The type of a loop: (address of the words, term, tick, dt) -> None."""

matrix, numbers, vector = frame.matrix, frame.numbers, frame.vector


@dataclass(frozen=True)
class CompiledLaw:
    """A law in machine code."""

    address: int
    """The address of its loop over members, which `call` calls."""
    states: int
    """Number of its state numbers."""
    code: object
    """The compiled function, which must live as long as the address is used."""


@numba.extending.intrinsic
def call(_: Any, address: Any, words: Any, term: Any, tick: Any, dt: Any) -> Any:
    """Call the loop of a law by its address; return whether the law has raised no exception."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        status, _ = call_at(context, builder, arguments[0], _LOOP, arguments[1:])
        return status.is_ok

    return numba.types.boolean(ADDRESS, *_LOOP.args), generate


@cache
def compiled_law(law: Law) -> CompiledLaw:
    """Compile a law. Raises FlockError, of one line, if it can't be compiled or is no law."""
    signature = signature_of(law)
    _check_repeatable(law)
    plain = anew_for_kernels(law, boundscheck=True)  # of arrays: IndexError
    states = _states_of(_result_of(plain, signature))
    if not states and {"state", "step_state"} & {*signature.given}:
        raise FlockError(f"it takes a state and returns no rates of it: must return {WITH_STATE}")
    ours = law.__module__.startswith(f"{PACKAGE.name}.")
    adapted = _adapted(plain, signature, states)
    loop = _copy(_with_state if states else _without_state, _law=adapted)
    loop.__qualname__ += f".{law.__module__}.{law.__qualname__}"
    compiled = (kernel if ours else anew_for_kernels)(loop)
    return CompiledLaw(address_of(compiled, _LOOP.args), states, compiled)


def _adapted(law: Law, signature: Signature, states: int) -> Law:
    """Return a law that takes all GIVEN arguments, the parameters as an array, and the member.

    With a state its numbers may be of any types, and those of the result are floats.
    """
    arguments = [
        *(f"{name}={name}" for name in signature.given),
        *(f"{name}=parameters[{row}, m]" for row, name in enumerate(signature.parameters)),
    ]
    rates = "".join(f"float(result[1][{k}]), " for k in range(states))
    names = {"law": law, "float": float, "__name__": __name__}
    floats = f"lambda result: (float(result[0]), ({rates}))" if states else "lambda result: result"
    names["floats"] = _inline(eval(floats, names))
    text = f"lambda {', '.join(GIVEN)}, parameters, m: floats(law({', '.join(arguments)}))"
    adapted: Law = _inline(eval(text, names))
    return adapted


def _inline(function: Any) -> Any:
    """Have numba copy a function into its callers, which compiles faster than a call."""
    return numba.njit(inline="always")(function)


def _copy(function: Any, **callees: Any) -> Any:
    """Return a function that calls `callees` by their names."""
    return FunctionType(function.__code__, {**globals(), **callees}, function.__name__)


def _result_of(law: Any, signature: Signature) -> Any:
    """Compile a law for its arguments; return the type of its result.

    The arrays are read-only: a law that writes into one is refused, since other laws get the same.
    """
    table, number = np.zeros((2, 2)), np.zeros(1, np.int64)
    for array in (table, number):
        array.flags.writeable = False
    row, column = table[0], table[:, 0]
    examples = dict(
        zip(
            GIVEN,
            (
                Bird(1, 1, *(6 * [1.0])),
                Neighbours(number, *(4 * [row])),
                *(1.0, column, column, column),
            ),
            strict=True,
        )
    )
    order = law.py_func.__code__.co_varnames[: law.py_func.__code__.co_argcount]
    types = tuple(numba.typeof(examples.get(name, 1.0)) for name in order)
    try:
        law.compile(types)
    except (numba.core.errors.NumbaError, UnsupportedBytecodeError, TypeError) as error:
        file = Path(law.py_func.__code__.co_filename).name
        raise FlockError(f"numba can't compile it: {_reason(error, file)}") from None
    return law.overloads[types].signature.return_type


def _states_of(result: Any) -> int:
    """Return the number of state numbers of a law with a type of result."""
    types = numba.types
    real = types.Integer, types.Float
    if isinstance(result, real):
        return 0
    if (
        isinstance(result, types.BaseTuple)
        and len(result) == 2
        and isinstance(result[0], real)
        and isinstance(result[1], types.BaseTuple)
        and all(isinstance(rate, real) for rate in result[1])
    ):
        if not 1 <= len(result[1]) <= MOST_STATES:
            raise FlockError(
                f"it has {len(result[1])} numbers of state: must have 1..{MOST_STATES}, or "
                "return the force alone"
            )
        return len(result[1])
    if isinstance(result, (types.Optional, types.NoneType)):
        raise FlockError(f"on some path it returns nothing: must be a number, or {WITH_STATE}")
    raise FlockError(f"it returns {result}: must be a number, the force, or {WITH_STATE}")


def _check_repeatable(law: Law) -> None:
    """Raise FlockError if a law, or a function of its file, draws random numbers of its own."""
    functions, seen = [law], set()
    while functions:
        function: Any = functions.pop()
        if function in seen:
            continue
        seen.add(function)
        functions += plain_callees(function)
        used = [function.__globals__.get(name) for name in function.__code__.co_names]
        if "random" in function.__code__.co_names or any(
            str(getattr(one, "__module__", "")).startswith(("random", "numpy.random"))
            for one in used
        ):
            raise FlockError(
                "it draws random numbers of its own, so no flight with it could be repeated: take "
                "the argument `noise`"
            )


def _reason(error: Exception, file: str) -> str:
    """Return in one line why numba could not compile a law in `file`."""
    lines = [line.strip() for line in str(error).splitlines()]
    noise = "Failed in", "During:", "-", "^", "File "
    told = next((line for line in lines if line and not line.startswith(noise)), str(error))
    if "setitem" in told and "readonly array" in str(error):
        told = "it writes into an array that it is given"
    call = next((line for line in lines if line.startswith(">>> ")), "")
    if told.endswith("signature:") and call:
        told = f"{told} {call.removeprefix('>>> ')}"
    places = [line for line in lines if line.startswith("File ")]
    place = next((line for line in reversed(places) if file in line), (places or [""])[0])
    return f"{told} ({place.rstrip(':')})" if place else told


def _law(*arguments: Any) -> Any:
    """Stand for the law of a loop."""
    raise NotImplementedError


def _without_state(address: int, term: int, tick: int, dt: float) -> None:
    """Add the force of a law without state to that on the bird, in each member."""
    words, own, now, number, lateral, near, noise, force, parameters = _arrays(address, term)
    time = (tick // STAGES + NODES[tick % STAGES]) * dt
    for m in range(force.size):
        bird = _bird(words, own, now, m)
        neighbours = _neighbours(number, lateral, near, force.size, m)
        none = noise[:0, m]
        added = float(_law(bird, neighbours, time, none, none, noise[:, m], parameters, m))
        if not np.isfinite(added):
            _note_fault(words, term, own, now, near, none, m)
        force[m] = canonical(force[m] + added)


def _with_state(address: int, term: int, tick: int, dt: float) -> None:
    """Do the same with a law that has a state, and fill in the rates of its state."""
    words, own, now, number, lateral, near, noise, force, parameters = _arrays(address, term)
    state, start, rate = _states(address, term, tick)
    time = (tick // STAGES + NODES[tick % STAGES]) * dt
    for m in range(force.size):
        bird = _bird(words, own, now, m)
        neighbours = _neighbours(number, lateral, near, force.size, m)
        mine = state[:, m]
        added, rates = _law(bird, neighbours, time, mine, start[:, m], noise[:, m], parameters, m)
        sound = np.isfinite(added)
        for k in range(len(rates)):
            rate[k, m] = canonical(rates[k])
            sound = sound and np.isfinite(rates[k])
        if not sound:
            _note_fault(words, term, own, now, near, mine, m)
        force[m] = canonical(force[m] + added)


@kernel
def _arrays(address: int, term: int) -> tuple[Any, ...]:
    """Return the words and the arrays of a law."""
    words = numbers(address, frame.FIRST_TERM + (term + 1) * frame.EACH)
    at = frame.FIRST_TERM + term * frame.EACH
    members, count = words[frame.MEMBERS], words[frame.NEIGHBOURS]
    return (
        words,
        matrix(words[frame.OWN], frame.OWN_ROWS, members),
        matrix(words[frame.NOW], 3, members),
        numbers(words[frame.NUMBER], count),
        matrix(words[frame.LATERAL], members, count),
        matrix(words[frame.NEAR], 3 * members, count),
        matrix(words[frame.NOISE] + 16 * members * words[at + frame.ORDINAL], 2, members),
        vector(words[frame.FORCE], members),
        matrix(words[at + frame.PARAMETERS], 1 << 32, members),
    )


@kernel
def _states(address: int, term: int, tick: int) -> tuple[Any, ...]:
    """Return the numbers of state of a law, those at the beginning of the step, and the rates."""
    words = numbers(address, frame.FIRST_TERM + (term + 1) * frame.EACH)
    at = frame.FIRST_TERM + term * frame.EACH
    members, rows = words[frame.MEMBERS], words[frame.STATES]
    first = words[at + frame.FIRST_STATE]
    last = first + words[at + frame.STATES_OF_LAW]
    return (
        matrix(words[frame.STATE] + 8 * (tick & 1) * rows * members, rows, members)[first:last],
        matrix(words[frame.START], rows, members)[first:last],
        matrix(words[frame.RATE], rows, members)[first:last],
    )


@kernel
def _bird(words: Any, own: Any, now: Any, m: int) -> Bird:
    return Bird(
        words[frame.BIRD],
        words[frame.LEADER],
        own[frame.SPAN_RATIO, m],
        own[frame.MASS, m],
        own[frame.THRUST, m],
        now[frame.POSITION, m],
        now[frame.SPEED, m],
        now[frame.CIRCULATION, m],
    )


@kernel
def _neighbours(number: Any, lateral: Any, near: Any, members: int, m: int) -> Neighbours:
    return Neighbours(number, lateral[m], near[m], near[members + m], near[2 * members + m])


@kernel
def _note_fault(words: Any, term: int, own: Any, now: Any, near: Any, state: Any, m: int) -> None:
    """Note that the result of a law of one's own is not finite, unless its member has diverged.

    A member that diverges must not end the flight of the others. That Flock's own laws overflow is
    such a divergence.
    """
    if words[frame.FAULT] or words[frame.FIRST_TERM + term * frame.EACH + frame.BUILT_IN]:
        return
    if _diverged(own[:, m]) or _diverged(now[:, m]) or _diverged(state):
        return
    for row in range(m, near.shape[0], words[frame.MEMBERS]):
        if _diverged(near[row]):
            return
    words[frame.FAULT] = frame.NOT_FINITE
    words[frame.FAULT_TERM], words[frame.FAULT_MEMBER] = term, m + 1


@kernel
def _diverged(values: Any) -> bool:
    """Whether a value is nan, or so large that sound laws may have no finite result."""
    return not (np.abs(values) < DIVERGED).all()
