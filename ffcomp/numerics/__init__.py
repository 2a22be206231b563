"""Disk cache, numba cache folder and small matrix-vector kernels."""
