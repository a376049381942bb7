"""Foundations of all packages: records, modes, clock, kernels, operating system."""
