"""The integrated control subsystem (ICS): navigation filters, guidance, control, allocation."""
