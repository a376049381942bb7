"""Simulated cameras: pose from axis positions, rendered images."""
