"""Commissioning of a rig: emergency stop, identity, sign and scale, limits, dry run, sign-off; axis identification."""
