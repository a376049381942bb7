"""Devices on wires in a session; their drivers are in ``hil.drivers``."""
