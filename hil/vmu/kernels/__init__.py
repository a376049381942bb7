"""The vision unit's arithmetic, compiled."""
