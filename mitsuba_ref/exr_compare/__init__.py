"""Comparison of two EXR files pixel by pixel (`two_files.compare_exr`)."""
