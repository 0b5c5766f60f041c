"""What `jit.py` is made of: arguments of kernels, their machine code, and where it is kept."""
