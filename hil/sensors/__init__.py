"""Sensors as modules: what each measures, what the filters expect of it, its errors and its faults."""
