"""FMI 2.0 and 3.0 for co-simulation: archives, model descriptions, binaries and steps of FMUs."""
