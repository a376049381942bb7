"""Commands of the vision unit."""
