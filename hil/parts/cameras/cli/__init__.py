"""Commands of the cameras."""
