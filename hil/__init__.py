"""Hardware-in-the-loop bench controller for spacecraft rendezvous and docking."""

__version__ = "0.1.0"
