# SPDX-License-Identifier: Apache-2.0
"""Random parameter files, sweep files and metadata.yaml: nearly valid, odd or damaged."""

from __future__ import annotations

from random import Random

from flock_sim.configuration.flock_configuration import KEYS, LISTS
from flock_sim.configuration.operation import OPERATION

VALUES = [
    *("", "~", "null", "yes", "y", "Off", "=", "<<", "é", "'\u202e'", "\ufeff", "a b"),
    *("- a", "? a", "{from: -1, to: 1e308, count: 3}", "[0.9, 1, 1.1]"),
    *("0", "-0", "1", "3", "13", "-1", "2.5", "1e4", "1e400", "-1e-400", "5e-324", ".nan", "-.inf"),
    *("089", "010", "0x_", "0b_", "0o7", "1_000", "1__", "._5", "+.5", "1:30", "190:20:30.15"),
    *("9" * 400, "9" * 401, "9" * 5000, "0." + "9" * 500, "2147483648", "9007199254740993"),
    *("2001-01-01", "2001-99-99", "2001-12-14t21:59:43.10-05:00", "'2001-01-01'"),
    *("!!int zz", "!!bool zz", "!!str 5", "!!float .", "!!binary x", "!!set {a}", "!a b", "! 5"),
    *("&a 1", "*a", "*b", "&b [1, *b]", "&c [*c]", "{<<: *a}", "[*a, *a]"),
    *('"\\0"', '"\\e]0;x\\a"', '"\\ud800"', '"\\x9b"', "'", '"', "[", "{", "]", "}", ",", "|", ">"),
    *("[]", "{}", "[[]]", "[{}]", "{a: 1}", "{a: {b: {c: 1}}}", "[1, 2, 3]", "[~]", "[true, a]"),
    *("nearest", "all", "some", "runs/a", "x" * 300, "/**", "ros__parameters"),
    *("{from: 1, to: 2, count: 3}", "{from: 1}", "{from: .nan, to: 1, count: 2}"),
    *("{from: 1, to: 2, count: 1e9}", "[" * 70, "{a: " * 70),
]  # fmt: skip

ENTRIES = [
    *("4=1.05", "4=1,1.1", "1=0.9", "0=1", "4=", "=1", "4=1e999", "4=nan", "4=0.1"),
    *("4@1=-0.1", "1:2@0=0,0.01", "all@3=0.1", "@", "4@99999999999999999999=1", "1@1e3=1"),
    *("hold", "hold:delay=1", "linear:delay=1/2/3", "3:4=hold", "3->4=linear:drop=0.5"),
    *("hold:delay=nan", "hold:seed=" + "9" * 5000, "hold:", ":", "->", "hold:delay", "x:y=z"),
    *("3->9=hold", "4=" + "1," * 50),
    *("sine", "constant:force=1", "3=gust:seed=1", "keeper:gap=2/3", "gust:force=inf", "a.py:b"),
    *("\\0.py:a", "\\e]0;x\\a", "é.py:é", "x" * 300 + ".py:a", "constant:force=1e999", "no_law"),
]  # fmt: skip

AXES = [
    *("span_ratio[2]", "span_ratio[99]", "lambda_3", "dt", "t_max", "birds", "coupling", "links"),
    *("link.delay", "link[3->4].drop", "link.x", "position[1]", "speed[99]", "links", "forcing"),
    *("forcing.constant.force", "forcing[3].sine.period", "forcing.a.b", "span_ratio[]", "link."),
]  # fmt: skip

SOUND = [
    *("birds: 5", "coupling: all", "dt: 0.5", "t_max: 1e2", "record_every: 20", "body_mass: 3.5"),
    *("span_ratios: [4=1.05]", "links: [hold]", "forcing: [sine:amplitude=1e-4]"),
]  # fmt: skip
"""Lines of parameters that go together."""

SOUND_AXES = [
    *("span_ratio[2]: [0.9, 1]", "dt: [1, 0.5]", "coupling: [nearest, all]", "position[1]: [0, 1]"),
    *("link.delay: {from: 0, to: 4, count: 3}", "aspect_ratio: [7, 8]", "links: [exact, hold]"),
]  # fmt: skip

SECTIONS = [
    *("/**", "/*", "/flock/*", "/flock/clock", "/flock/bird_03", "flock", "/**/bird_03", "clock"),
    *("/a b", "/", "", "**", "/flock/**/x", "/**/**/**/**", '"\\e[2J"', "ros__parameter"),
]  # fmt: skip

INSERTED = [
    *VALUES,
    *("\n", "\n  ", "\n---\n", "...\n", "#", ": ", " ", "\t", "\0", "\x1b", "\r", "\x85"),
]


def parameter_file(random: Random) -> str:
    """Return the text of a parameter file."""
    text = ""
    for _ in range(random.choice([1, 1, 1, 2, 5])):
        section = "/**" if random.random() < 0.7 else random.choice(SECTIONS)
        text += f"{section}:\n  ros__parameters:\n"
        text += "".join(f"    {line}\n" for line in _parameters(random))
    return _damaged(random, text)


def sweep_file(random: Random) -> str:
    """Return the text of a sweep file."""
    text = "flock:\n" + "".join(f"  {line}\n" for line in _parameters(random)) + "axes:\n"
    for _ in range(random.choice([1, 1, 2, 4])):
        odd = f"{_name(random, AXES)}: {_value(random)}"
        text += f"  {odd if random.random() < 0.2 else random.choice(SOUND_AXES)}\n"
    return _damaged(random, text)


def metadata_file(random: Random, sound: str) -> str:
    """Return a metadata.yaml like the `sound` one."""
    lines = sound.splitlines()
    for _ in range(random.choice([0, 1, 2, 5])):
        k = random.randrange(len(lines))
        key, colon, _ = lines[k].partition(": ")
        lines[k] = f"{key}{colon}{_value(random)}"
    return _damaged(random, "\n".join(lines) + "\n")


def _parameters(random: Random) -> list[str]:
    """Return lines with parameters of the flock and, seldom, of the operation of nodes."""
    if random.random() < 0.6:
        return random.sample(SOUND, random.randint(0, 3))
    names = list(KEYS if random.random() < 0.8 else (*KEYS, *OPERATION))
    found = []
    for _ in range(random.choice([0, 1, 1, 2, 3, 6])):
        name = _name(random, names)
        found.append(f"{name}: {_entries(random) if name in LISTS else _value(random)}")
    return found


def _name(random: Random, names: list[str]) -> str:
    return random.choice(names if random.random() < 0.95 else VALUES)


def _entries(random: Random) -> str:
    chosen = [random.choice(ENTRIES) for _ in range(random.choice([0, 1, 1, 2, 4]))]
    return "[" + ", ".join(f'"{each}"' for each in chosen) + "]"


def _value(random: Random) -> str:
    return random.choice(VALUES) if random.random() < 0.9 else _entries(random)


def _damaged(random: Random, text: str) -> str:
    """Return the text as it is or, in every third case, with some damage."""
    for _ in range(random.choice([0, 0, 0, 0, 1, 3])):
        first, last = sorted(random.randrange(len(text) + 1) for _ in range(2))
        last = min(last, first + random.choice([0, 1, 5, 50]))
        text = random.choice(
            [
                text[:first] + text[last:],
                text[:first] + text[first:last] * 2 + text[last:],
                text[:first] + random.choice(INSERTED) + text[first:],
                text[:first],
            ]
        )
    return text
