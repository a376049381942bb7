"""Sessions: the loop of a scenario, assembled and built for a rig, warmed up and run."""
