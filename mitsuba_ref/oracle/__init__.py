"""Exact arithmetic on rays and primitives in integers: the oracle (oracle.py) and its exact kinds.

Every float64 is an integer times a power of two. All numbers of a ray and a primitive are scaled to a common power of
two, after which additions, products and signs are exact. Imports only the standard library and NumPy.
"""
