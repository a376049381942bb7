"""Control cycle: stages, motion sequences, runner, rate and overruns."""
