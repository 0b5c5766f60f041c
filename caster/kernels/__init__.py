"""Code that runs per ray: plain Python over floats and arrays, compiled if Numba is installed."""
