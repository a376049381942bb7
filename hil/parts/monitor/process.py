"""Docking monitor process of a paced run: rendered camera and monitor, fed by the loop's telemetry.

``python -m hil.parts.monitor.process`` is started by ``MonitorProcess``.
"""

from hil.core.child_process import Parent
from hil.parts.monitor.setup import run_child


def main() -> None:
    """Monitor until the parent closes stdin, then send the results."""
    run_child(Parent())


if __name__ == "__main__":
    main()
