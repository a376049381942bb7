"""GNC on another computer, and the check of a GNC."""
