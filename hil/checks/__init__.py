"""Checks of scenario and rig before a run."""
