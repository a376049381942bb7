"""Recordings for other programs."""
