"""Vision unit in a session, its calibration at the bench, and their commands; poses are computed in ``hil.vmu``."""
