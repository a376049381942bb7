"""ABB robots on EGM, the controller's interface for externally guided motion, and an emulated controller."""
