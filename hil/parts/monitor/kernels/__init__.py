"""Kernels of the docking monitor."""
