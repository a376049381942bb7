"""Assembly of a loop from scenario and rig."""
