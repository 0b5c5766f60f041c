"""Meshes, transforms to world space and the packed primitives that kernels read."""
