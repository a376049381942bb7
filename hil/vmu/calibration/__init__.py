"""Calibration of the vision unit from views at known places of the bench, and the check of later days."""
