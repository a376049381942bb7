"""Public Python API, which ``import hil`` re-exports: runs, recordings, campaigns, and the bench under a procedure."""
