"""Parameter records of the kernels, from user units to SI."""
