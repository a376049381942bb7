"""The docking monitor as printed in the monitor paper."""
