# SPDX-License-Identifier: Apache-2.0
"""The exact discretisation of an Ornstein-Uhlenbeck process, computed in decimal arithmetic.

The decimals give the same bits on every machine, and enough digits for steps that are short or long
compared with the correlation time.
"""

from __future__ import annotations

from decimal import Context, Decimal, localcontext

DIGITS = 80


def coefficients(std: float, time: float, dt: float) -> tuple[float, float, float, float, float]:
    """Return the coefficients of a step of a process of standard deviation `std`.

    With a the process at the beginning of the step, a' at its end and A its mean over the step, all
    of one process with correlation time `time`, and xi, zeta independent standard normal numbers:

        (a' - a) / dt = c[0] a + c[1] xi            A = c[2] a + c[3] xi + c[4] zeta

    With d = dt / time, e = exp(-d) and the integral I = A dt:

        E a' = e a                                  var a' = std^2 (1 - e^2)
        E I = time (1 - e) a                        var I = std^2 time^2 (2 d - 3 + 4 e - e^2)
        cov(a', I) = std^2 time (1 - e)^2

    (Gillespie, Exact numerical simulation of the Ornstein-Uhlenbeck process and its integral,
    Physical Review E 54, 1996.)
    """
    with localcontext(Context(prec=DIGITS, Emin=-(10**6), Emax=10**6)):
        s, tau, step = Decimal(std), Decimal(time), Decimal(dt)
        d = step / tau
        e = (-d).exp()
        end = (1 - e * e).sqrt()
        together = tau * (1 - e) * (1 - e) / end
        rest = tau * tau * (2 * d - 3 + 4 * e - e * e) - together * together
        alone = max(rest, Decimal(0)).sqrt()
        found = (e - 1, s * end, tau * (1 - e), s * together, s * alone)
        first, second, third, fourth, fifth = (float(each / step) for each in found)
    return first, second, third, fourth, fifth
