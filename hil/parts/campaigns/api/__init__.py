"""Python API of campaigns."""
