"""Devices that are served by a process of their own: the loop's side touches shared memory and never a wire."""
