"""Test campaigns in pytest: ``pytest --rig mock|emulated|FILE`` with the fixtures ``bench``, ``run`` and ``rig``."""
