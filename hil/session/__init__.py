"""Sessions: a bench built for a rig, run and closed."""
