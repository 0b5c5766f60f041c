"""Tolerances of the judge beside the bounds of predicted intersections, each with its derivation."""

# Means of groups whose signs are tosses of a coin give |z| >= x with a probability of at most 2 exp(-x^2 / 2),
# however many and however large they are (Hoeffding): 7.5e-6 for 5. No |z| exceeds the root of the number of groups.
LARGEST_Z = 5.0
MIN_GROUPS = int(LARGEST_Z**2) + 1  # with fewer, no bias whatever could fail

# Where normals are not bounded any closer than this, float32 says nothing useful of the pixel: an angle of 3.6 degrees.
LARGEST_USEFUL_NORMAL_ERROR = 2.0**-4

# A hypothesis of the diagnosis is reported where it predicts the number to this share of itself: far beyond rounding
# in float32, far below any of the faults that are distinguished. No pixel passes or fails by it.
MATCH_RTOL = 1e-4
DISTINCT_RTOL = 10 * MATCH_RTOL  # two numbers that are so far apart are not alike
MAJORITY = 0.5  # what is reported of all wrong t at once has to be true of more of them than this

# Scene check `camera`: a direction goes through an orthobasis (three unit vectors of 4 roundings each), a position on
# the film (4), a sine or tangent (2) of an angle of up to pi, and a length (3): 32 roundings on either side, in steps
# of KU_OURS, which is K roundings on either side.
CAMERA_ROUNDINGS = 8.0

# Scene check `geometry`: a packed number is a dot product and a sum, or a normal made of two of them and its length: a
# dozen roundings. In float32 it is rounded once more.
TRANSFORM_ROUNDINGS = 16.0
