"""The docking monitor: range, rate and angles from one television camera (the monitor paper)."""
