"""Part ``ranging`` of ``hil``, declared in ``hil_ranging.part``."""
