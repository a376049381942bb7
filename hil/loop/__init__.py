"""The control cycle: stages, run sequence, rate, overruns."""
