"""Devices of the bench: one Protocol each, behind it a mock, drivers on real wires and their emulators."""
