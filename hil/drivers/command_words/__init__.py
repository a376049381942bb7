"""Thrusters on or off as digital words of a flight computer, over a serial port or CAN."""
