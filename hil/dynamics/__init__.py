"""The dynamics simulation subsystem (DSS): truth, virtual IMU, virtual vision noise."""
