"""Emulators of all devices on their wires, by the wall clock or in lock-step."""
