"""Exact arithmetic on rays and primitives in integers: the oracle (oracle.py) and its exact kinds.

Every float64 is a whole number times a power of two. All numbers of one ray and one primitive are brought to a common
power of two; additions, products and signs are exact from there on. Imports the standard library and NumPy only.
"""
