# SPDX-License-Identifier: Apache-2.0
"""Sine and cosine in plain IEEE arithmetic, with the same bits on every machine.

Those of the C library differ in their last bits between libraries and processors. Here there are
only additions, multiplications, comparisons and selections, which IEEE 754 defines to the last bit.
The compiler can vectorise them.
"""

from math import pi

TURN = 2.0 * pi
"""The angle of a turn, in rad."""

SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
"""sin(x) = x + x^3 (SINE[0] + SINE[1] x^2 + ...) for |x| <= pi / 4."""

COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
"""cos(x) = 1 - x^2 / 2 + x^4 (COSINE[0] + COSINE[1] x^2 + ...) for |x| <= pi / 4."""


def sine_and_cosine(turns: float) -> tuple[float, float]:
    """Return sine and cosine of an angle in turns, 0 <= `turns` <= 1.

    Both are exact at multiples of a quarter turn; the error is below 1.9 ulp otherwise. Subtracting
    the nearest multiple of a quarter turn is exact. The polynomials of the rest are those of fdlibm
    (k_sin.c and k_cos.c, Sun Microsystems 1993), and the last additions of the cosine are those of
    FreeBSD's k_cos.c, which has no branches.

    This is a plain function of numbers. `physics.compile.kernel` compiles it to the same bits.
    """
    quarter = 0.0
    for border in (0.125, 0.375, 0.625, 0.875):
        quarter = quarter + 0.25 if turns >= border else quarter
    x = TURN * (turns - quarter)

    z = x * x
    sine, cosine = SINE[5], COSINE[5]
    for k in (4, 3, 2, 1, 0):
        sine = SINE[k] + z * sine
        cosine = COSINE[k] + z * cosine
    sine = x + x * z * sine
    half = 0.5 * z
    close = 1.0 - half
    cosine = close + ((1.0 - close - half) + z * z * cosine)

    # sin(x + pi / 2) = cos(x), cos(x + pi / 2) = -sin(x); and so on.
    odd = (quarter == 0.25) | (quarter == 0.75)
    rising, falling = (cosine, sine) if odd else (sine, cosine)
    return (
        -rising if (quarter == 0.5) | (quarter == 0.75) else rising,
        -falling if (quarter == 0.25) | (quarter == 0.5) else falling,
    )
