"""Commands of the commissioning."""
