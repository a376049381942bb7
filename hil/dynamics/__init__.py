"""The dynamics simulation subsystem (DSS): truth and virtual IMU."""
