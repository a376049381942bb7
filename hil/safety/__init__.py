"""Safety of the bench: monitor, emergency stop, alarms, packet loss. No I/O; time is an argument."""
