"""Commissioning: a technician takes a rig from its emergency stop to a slow dry run, and signs it off."""
