"""Docking monitor process of a paced run: rendered camera and monitor, fed by the loop's telemetry.

``python -m hil.processes.docking_monitor`` is started by ``MonitorProcess``.
"""

from hil.core.child_process import Parent
from hil.setup.docking_monitor import run_child


def main() -> None:
    """Monitor until the parent closes stdin, then send the results."""
    run_child(Parent())


if __name__ == "__main__":
    main()
