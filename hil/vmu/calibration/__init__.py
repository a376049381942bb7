"""Calibration of the vision unit from views at measured positions of the bench, and drift check."""
