"""Geometry of the bench: plan of poses, measurement, bundle fit, and drift check."""
