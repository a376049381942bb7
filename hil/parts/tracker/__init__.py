"""Tracker of a bench: motion capture or laser tracker as an independent truth of its poses."""
