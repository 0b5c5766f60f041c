"""Tolerances of the judge beside the bounds of predicted intersections, each with its derivation."""

# Means of groups whose signs are tosses of a coin give |z| >= x with a probability of at most 2 exp(-x^2 / 2),
# however many and however large they are (Hoeffding): 7.5e-6 for 5. No |z| exceeds the root of the number of groups.
LARGEST_Z = 5.0
MIN_GROUPS = int(LARGEST_Z**2) + 1  # with fewer, no bias whatever could fail
