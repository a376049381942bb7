"""Turntable on a serial line: ASCII protocols described by a file."""
