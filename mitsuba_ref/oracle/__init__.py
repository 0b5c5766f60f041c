"""Rays and primitives in integers: what the oracle `mitsuba_ref.oracle.oracle` is made of.

Every float64 is a whole number times a power of two. All numbers of one ray and one primitive go on a common power of
two, and from there on nothing is rounded: additions, products, signs. Imports the standard library and NumPy only.
"""
