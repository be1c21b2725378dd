# SPDX-License-Identifier: Apache-2.0
"""Numbers in a report are written for people."""

import pytest

from flock_tools.report.key_numbers import fixed, power


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (1.234e-5, 1, "1.2 × 10⁻⁵"),
        (-2.5e12, 2, "−2.50 × 10¹²"),
        (1e-4, 0, "10⁻⁴"),
        (-0.0256, 1, "−0.026"),
        (999.9, 2, "1000"),
        (0.0, 2, "0"),
        (float("nan"), 2, "not finite"),
        (float("-inf"), 2, "not finite"),
    ],
)
def test_small_and_large_numbers_have_a_power_of_ten(
    value: float, decimals: int, text: str
) -> None:
    assert power(value, decimals).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(
    ("value", "text"), [(1.02777, "1.028"), (-3.0, "−3.000"), (2e300, "2.00 × 10³⁰⁰")]
)
def test_only_large_numbers_lose_their_decimals(value: float, text: str) -> None:
    assert fixed(value, 3).replace("\N{NO-BREAK SPACE}", " ") == text
