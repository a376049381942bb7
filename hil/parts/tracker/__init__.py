"""Tracker of a bench: motion capture, laser tracker or total station as an independent truth of its poses."""
