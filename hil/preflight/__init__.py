"""Whether this host and this rig can run in real time and reach a scenario, before anything depends on it."""
