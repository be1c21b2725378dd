# SPDX-License-Identifier: Apache-2.0
"""The natural logarithm, made of operations that IEEE 754 rounds correctly on every machine.

The C library's log and log1p differ in their last bits between processors and versions, and a loop
that calls them can't be vectorised. These functions have additions, multiplications, divisions,
shifts of bits and selections only, and no branch.

The method is that of fdlibm (Sun Microsystems 1993, e_log.c), for a quotient n / d. With
2^k the power of two nearest to n / d, and t = (n - 2^k d) / (n + 2^k d),

    ln(n / d) = k ln 2 + 2 artanh(t),    2 artanh(t) = 2 t + t^3 R(t^2),    |t| <= 0.2004

These are plain functions of numbers; kernels that call them compile them in.
"""

import numpy as np

# ln 2 in two parts. The high part has so many zeros at its end that its product with k is exact.
LN2_HIGH = 6.93147180369123816490e-01
LN2_LOW = 1.90821492927058770002e-10

# R(z) = 2 (artanh(t) / t - 1) / z with z = t^2: the polynomial of degree 7 whose error, in units of
# ln(n / d), has the least maximum on 0 <= z <= 0.2004^2. This maximum is 1.4e-19 (Remez's method).
R0 = 0.666666666666666
R1 = 0.40000000000057484
R2 = 0.28571428555642325
R3 = 0.22222224316794958
R4 = 0.1818166468952376
R5 = 0.15391149893152248
R6 = 0.13172971978685574
R7 = 0.1384722791337243

_FRACTION_BITS = 52
_HALF = 1 << (_FRACTION_BITS - 1)


def log_of_quotient(n: float, d: float, difference: float) -> float:
    """Return ln(n / d), where `difference` is n - d without the error of the subtraction.

    `n` and `d` are normal positive numbers. The error is below 2 ulp of the result, if `n`, `d` and
    `difference` are exact; otherwise near n = d it is the relative error of `difference`.
    """
    # The bits of a double, as an integer, are 2^52 times a logarithm to base 2, to 0.0861.
    d_bits = np.float64(d).view(np.int64)
    k = (np.float64(n).view(np.int64) - d_bits + _HALF) >> _FRACTION_BITS
    scaled = np.int64(d_bits + (k << _FRACTION_BITS)).view(np.float64)
    t = (difference if k == 0 else n - scaled) / (n + scaled)
    z = t * t
    w = z * z
    odd = R1 + w * (R3 + w * (R5 + w * R7))
    r = R0 + w * (R2 + w * (R4 + w * R6)) + z * odd
    exponent = float(k)
    return exponent * LN2_HIGH + ((t + t) + (t * z * r + exponent * LN2_LOW))


def log(x: float) -> float:
    """Return ln(x) of a normal positive number, to 2 ulp."""
    return log_of_quotient(x, 1.0, x - 1.0)
