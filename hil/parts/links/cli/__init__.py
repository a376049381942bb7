"""Commands of a GNC elsewhere."""
