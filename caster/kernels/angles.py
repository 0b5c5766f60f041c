"""Sines and cosines without a branch or a call, so that loops over pixels can work several out at once.

The bits are the same with and without compiling, on every machine: only sums and products of float64 are taken.
"""

import math

from caster.kernels.jit import inlined

# The Taylor series of sin(h) / h and cos(h) in h^2. At h = pi / 2 the first terms left out are
# (pi / 2)^24 / 25! = 3e-21 and (pi / 2)^24 / 24! = 8e-20: nothing beside a rounding, 1e-16.
TERMS = 12
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(TERMS))
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(TERMS))


@inlined
def sine_and_cosine(square: float) -> tuple[float, float]:
    """(sin(h) / h, cos(h)) for square = h^2 and h at most a quarter turn, each within 2^-51."""
    sine, cosine = SINE[TERMS - 1], COSINE[TERMS - 1]
    for k in range(TERMS - 2, -1, -1):
        sine, cosine = sine * square + SINE[k], cosine * square + COSINE[k]
    return sine, cosine
