"""Compilation of kernels by Numba, and the cache of their object code."""
