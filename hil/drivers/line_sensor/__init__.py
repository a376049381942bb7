"""Sensors that send lines of text on a serial wire: driver and emulator."""
