"""Cycle as one compiled function: for campaigns, and for unattended runs on the mock rig."""
