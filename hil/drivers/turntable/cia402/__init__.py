"""Turntable on CAN: CANopen drives with the CiA 402 profile."""
