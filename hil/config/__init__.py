"""Scenario and rig files: their models, and the one place where they are read and checked."""
