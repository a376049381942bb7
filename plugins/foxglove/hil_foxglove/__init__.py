"""Live Foxglove server of a console: a part of ``hil``, declared in ``hil_foxglove.part``."""
