# SPDX-License-Identifier: Apache-2.0
"""What a law may be, what it is given, and how a flight ends in which one fails."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import BirdCoefficients, Scales
from flock_sim.reference.integrator import Reference
from support.own_laws import with_law
from support.python_process import python


def fly(flock: FlockConfiguration) -> Reference:
    flight = Reference(flock)
    flight.advance(flock.steps)
    return flight


# source -> words of the message
REFUSED = [
    ("def law(bird): return 'much'", ["it returns", "must be a number, the force, or (force,"]),
    ("def law(bird): pass", ["on some path it returns nothing", "must be a number"]),
    (
        "def law(bird):\n  if bird.speed > 1: return 1.0",
        ["on some path it returns nothing", "must be a number"],
    ),
    (
        "import numpy as np\ndef law(bird): return np.random.randn()",
        ["draws random numbers of its own", "take the argument `noise`"],
    ),
    (
        "from random import gauss\ndef law(bird): return draw()\ndef draw(): return gauss(0, 1)",
        ["draws random numbers of its own"],
    ),
    ("def law(bird):\n  print(f'{bird.speed:.3f}')\n  return 0.0", ["format spec in f-strings"]),
    (
        "import numpy as np\ndef law(bird): return np.clip(bird.speed, -1.0, 1.0)",
        ["clip", "signature: ", "float64", "laws.py", "line"],
    ),
    ("def law(bird): return bird.speed > 1", ["it returns bool", "must be a number"]),
    ("def law(bird): return 1j * bird.speed", ["it returns complex128", "must be a number"]),
    ("def law(neighbours): return neighbours.speed", ["it returns", "array", "must be a number"]),
    ("def law(bird): return 1.0, 2.0", ["it returns", "must be a number, the force, or (force,"]),
    ("def law(bird): return 1.0, [2.0]", ["it returns", "list", "must be a number"]),
    ("def law(bird): return 1.0, ()", ["0 numbers of state", "1..16", "or return the force"]),
    (
        f"def law(bird): return 1.0, ({17 * '0.0, '})",
        ["17 numbers of state", "1..16", "or return the force alone"],
    ),
    ("def law(state): return state[0]", ["takes a state and returns no rates", "return (force,"]),
    ("def law(step_state): return 1.0", ["takes a state and returns no rates"]),
    ("def law(bird): return bird.sped", ["numba can't compile it", "'sped'", "laws.py", "line 2"]),
    ("def law(bird): return wind", ["numba can't compile it", "name 'wind' is not defined"]),
    ("def law(bird): return open('x')", ["numba can't compile it", "'open'", "line 2"]),
    (
        "def law(bird):\n    if bird.speed > 1.0:\n        return 1.0\n    return 1.0, (2.0,)",
        ["numba can't compile it", "Can't unify return type"],
    ),
    (
        "def law(neighbours):\n    neighbours.speed[0] = 2.0\n    return 0.0",
        ["writes into an array that it is given", "line 3"],
    ),
    (
        "def law(noise):\n    noise[0] = 2.0\n    return 0.0",
        ["writes into an array that it is given"],
    ),
    ("def law(bird, *rest): return 0.0", ["its argument *rest", "without *, ** or /"]),
    ("def law(bird, **rest): return 0.0", ["its argument **rest", "without *, ** or /"]),
    ("def law(bird, *, gain=1.0): return 0.0", ["its argument gain", "without *, ** or /"]),
    ("def law(bird, /): return 0.0", ["its argument bird", "without *, ** or /"]),
    ("def law(bird, gain='x'): return 0.0", ["parameter 'gain' is 'x'", "must be a number"]),
    ("def law(bird, gain=True): return 0.0", ["parameter 'gain' is True", "must be a number"]),
    ("def law(bird, gain=None): return 0.0", ["parameter 'gain' is None", "must be a number"]),
]


@pytest.mark.parametrize(("source", "words"), REFUSED)
def test_what_is_no_law_is_refused_in_one_line(
    source: str, words: list[str], tmp_path: Path
) -> None:
    with pytest.raises(FlockError) as caught:
        with_law(tmp_path, f"\n{source}\n", "law")
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    for word in ("laws.py:law", *words):
        assert word in message, message


@pytest.mark.parametrize(
    ("term", "words"),
    [
        ("law", ["gain is missing", "give gain=VALUE"]),
        ("law:gian=1", ["unknown key 'gian'", "did you mean 'gain'?", "known are gain, seed"]),
        ("law:gain=much", ["gain=much must be a finite number"]),
        ("law:gain=inf", ["gain=inf must be a finite number"]),
        ("law:gain=1,seed=-1", ["seed=-1 must be a whole number, 0..2^53"]),
        ("law:gain=1,bird=2", ["unknown key 'bird'"]),
        ("law:gain=1/2,seed=1/2/3", ["gain has 2 values and seed 3"]),
    ],
)
def test_bad_parameters_of_a_law_are_refused_in_one_line(
    term: str, words: list[str], tmp_path: Path
) -> None:
    with pytest.raises(FlockError) as caught:
        with_law(tmp_path, "def law(bird, noise, gain): return gain * noise[0]\n", term)
    message = str(caught.value)
    assert "\n" not in message
    for word in ("laws.py:law", *words):
        assert word in message, message


FIVE = """
import math

import numba

SCALE = 2.0


def twice(x):
    return SCALE * x


@numba.njit
def half(x):
    return 0.5 * x


def one(bird):
    return 1


def other(force=0.25):
    return twice(half(force + 0.75))


def third(bird):
    def once(x):
        return x

    return once(1.0)


@numba.njit
def fourth(bird):
    return math.sqrt(1.0)


def fifth(bird, state):
    return 1, (0, 2.0, True + 0)


sixth = lambda bird: 1.0
"""


@pytest.mark.slow
def test_a_law_may_call_functions_of_its_file_and_return_whole_numbers(tmp_path: Path) -> None:
    plain = fly(FlockConfiguration(birds=1, t_max=5.0, forcing=("constant:force=1",)))
    for name in ("one", "other", "third", "fourth", "fifth", "sixth"):
        flight = fly(with_law(tmp_path, FIVE, name, birds=1, t_max=5.0))
        assert flight.speed.tobytes() == plain.speed.tobytes(), name
    assert flight.forcing_state.shape == (1, 0, 1)
    fifth = fly(with_law(tmp_path, FIVE, "fifth", birds=1, t_max=5.0))
    assert fifth.forcing_state[0, :, 0].tolist() == pytest.approx([0.0, 10.0, 5.0])


TELLING = """
def law(bird, neighbours, time, step_state, item, of=0):
    k = int(of)
    values = (
        float(bird.number), float(bird.leader), bird.span_ratio, bird.mass, bird.thrust,
        bird.position, bird.speed, bird.circulation, time, float(len(neighbours.number)),
        float(neighbours.number[k]), neighbours.lateral[k], neighbours.position[k],
        neighbours.speed[k], neighbours.circulation[k],
    )
    return 0.0, (values[int(item)] if time == 0.0 else 0.0,)
"""


def told(flock: dict[str, object], directory: Path, item: int, of: int = 0) -> FloatArray:
    """Return what a law is given at time 0, (birds, members).

    It is the rate of its state at the first stage, so RK4 makes it dt / 6 of it.
    """
    configuration = with_law(
        directory, TELLING, f"law:item={item},of={of}", dt=1.0, t_max=1.0, **flock
    )
    return np.asarray(6.0 * fly(configuration).forcing_state[:, 0])


UNEQUAL = {"birds": 4, "coupling": "all", "span_ratios": ("2=0.9,1.1", "3=1.2")}


def test_a_law_is_given_the_constants_and_values_of_its_bird(tmp_path: Path) -> None:
    start = Reference(FlockConfiguration(**UNEQUAL))
    constants = BirdCoefficients.of(start.flock.scales, start.flock.span_ratio)
    number = np.arange(1.0, 5.0)[:, np.newaxis]
    expected = [
        np.broadcast_to(number, (4, 2)),
        np.full((4, 2), 3.0),
        start.flock.span_ratio,
        constants.mass,
        constants.thrust,
        start.position,
        start.speed,
        constants.circulation / start.speed,
        np.zeros((4, 2)),
        np.full((4, 2), 3.0),
    ]
    for item, values in enumerate(expected):
        found = told(UNEQUAL, tmp_path, item)
        np.testing.assert_allclose(found, values, rtol=1e-15, atol=1e-15, err_msg=str(item))


def test_a_law_is_given_its_neighbours_in_ascending_order(tmp_path: Path) -> None:
    start = Reference(FlockConfiguration(**UNEQUAL))
    ratio = start.flock.span_ratio
    circulation = start.observe()[2]
    for of in range(3):
        others = [[j for j in range(4) if j != i][of] for i in range(4)]
        lateral = np.array(
            [
                math.copysign(1.0, j - i)
                * formation.lateral_distance(ratio[min(i, j) : max(i, j) + 1])
                for i, j in enumerate(others)
            ]
        )
        for item, values in enumerate(
            [
                np.broadcast_to(np.array(others)[:, np.newaxis] + 1.0, (4, 2)),
                lateral,
                start.position[others],
                start.speed[others],
                circulation[others],
            ],
            start=10,
        ):
            found = told(UNEQUAL, tmp_path, item, of)
            np.testing.assert_allclose(found, values, rtol=1e-15, atol=1e-15, err_msg=str(item))


FAILING = """
def nan(bird, time, after=3.0):
    return 0.0 * (1.0 / (time <= after)) if bird.number == 2 else 0.0


def inf(bird, time, after=3.0):
    return 1.0 / (time <= after)


def rate(bird, state, time, after=3.0):
    return 0.0, (1.0 / (time <= after),)


def raising(bird, time, after=3.0):
    if time > after:
        raise ValueError("too late")
    return 0.0


def index(neighbours, time, after=3.0):
    return neighbours.speed[7] if time > after else 0.0


def pick(values, k):
    return values[k]


def index_in_a_function(neighbours, time, after=3.0):
    return pick(neighbours.speed, 7) if time > after else 0.0
"""


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("nan", ["bird 2, step 3:", "laws.py:nan", "returns nan or inf", "mend the law"]),
        ("inf", ["bird 1, step 3:", "laws.py:inf", "returns nan or inf"]),
        ("rate", ["bird 1, step 3:", "laws.py:rate", "returns nan or inf"]),
        ("raising", ["bird 1, step 3:", "laws.py:raising", "has raised an exception"]),
        ("index", ["bird 1, step 3:", "laws.py:index", "has raised an exception"]),
        ("index_in_a_function", ["bird 1, step 3:", "has raised an exception"]),
        ("inf:after=3/5", ["bird 1, step 3:", "in member 1"]),
        ("inf:after=5/3", ["bird 1, step 3:", "in member 2"]),
    ],
)
def test_a_law_that_fails_ends_the_flight_in_one_line(
    law: str, words: list[str], tmp_path: Path
) -> None:
    # The second stage of step 3 is the first one after time 3.
    flock = with_law(tmp_path, FAILING, law, birds=3, t_max=10.0)
    with pytest.raises(RunFailed) as caught:
        fly(flock)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 1
    for word in words:
        assert word in message, message


def test_a_member_that_has_diverged_does_not_end_the_flight(tmp_path: Path) -> None:
    """A force in proportion to a speed that grows without bound is inf, which is no fault."""
    source = """
    def law(bird, neighbours, gain):
        return gain * bird.speed * bird.speed + 0.0 * neighbours.speed[0]
    """
    flight = fly(with_law(tmp_path, source, "law:gain=0/1e3/0", birds=2, t_max=100.0))
    assert not np.isfinite(flight.speed[:, 1]).any()
    plain = fly(FlockConfiguration(birds=2, t_max=100.0))
    for member in (0, 2):
        assert flight.speed[:, member].tobytes() == plain.speed[:, 0].tobytes()


def test_a_law_is_given_the_present_values_of_scales(tmp_path: Path) -> None:
    """The force of one law is not part of the thrust that another one is given."""
    source = "def law(bird): return -bird.thrust\n"
    flock = with_law(tmp_path, source, "law", birds=1, t_max=20.0)
    entries = ("constant:force=0.5", *flock.forcing, "constant:force=-0.5")
    flight = fly(FlockConfiguration.given({**flock.parameters(), "forcing": entries}))
    assert flight.speed[0, 0] == pytest.approx(float(fly(flock).speed[0, 0]), rel=1e-14)
    assert flight.speed[0, 0] < Scales.of(flock).cruise_speed


TOGETHER = """
import sys
from pathlib import Path
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.kernel_cache import KernelCache
from flock_sim.reference.integrator import Reference

elsewhere, paths = Path(sys.argv[1]), KernelCache._paths
KernelCache._paths = lambda self, key: (
    elsewhere / path.name if "_state." in path.name else path
    for path in paths(self, key)
)
for text in sys.argv[2:]:
    given = {"birds": 1, "dt": 1.0, "t_max": 10.0, "forcing": [text]}
    flight = Reference(FlockConfiguration.given(given))
    flight.advance(10)
    print(flight.speed[0, 0].hex())
"""


@pytest.mark.slow
def test_a_law_from_disk_is_its_own_beside_one_that_was_compiled_before(tmp_path: Path) -> None:
    """numba numbers functions in each process, and the code on disk has another one's numbers."""
    (tmp_path / "laws.py").write_text("def own(bird): return 1e-3 * bird.mass", encoding="utf-8")
    own, built_in = f"{tmp_path}/laws.py:own", "constant:force=1e-4"

    def speeds(*forcing: str) -> list[str]:
        return python(TOGETHER, tmp_path, *forcing).split()

    kept = speeds(built_in)
    assert list(tmp_path.glob("*.kernel")) != []
    assert speeds(own, built_in) == [*speeds(own), *kept]
