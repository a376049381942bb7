"""Fibre reflective memory of the bench paper: what one process writes, the others see. On one host: shared memory."""
