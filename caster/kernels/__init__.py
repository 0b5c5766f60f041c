"""Everything that runs per ray: plain Python over floats and arrays, compiled by Numba when it is there."""
