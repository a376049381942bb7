"""Turntable drivers and their emulators: CiA 402 drives on CAN, and a serial ASCII controller."""
