"""Deciding whether the bench may go on: no input, no output, time handed in."""
