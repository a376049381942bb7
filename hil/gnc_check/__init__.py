"""Plays a known sequence to a GNC of the user's own and says in words what is wrong with its answers."""
