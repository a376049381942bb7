"""Campaigns: many runs, and their statistics."""
