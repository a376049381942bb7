"""KUKA robots on RSI, the controller's interface for corrections in each of its cycles, and an emulated controller."""
