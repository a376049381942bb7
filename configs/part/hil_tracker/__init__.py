"""Part ``tracker`` of ``hil``, declared in ``hil_tracker.part``."""
