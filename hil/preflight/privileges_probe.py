"""Privileges probe: requests the real-time privileges of a run and sends what was refused.

``python -m hil.preflight.privileges_probe`` is started by ``hil.preflight.host``; the privileges end with it.
"""

from hil.core.child_process import Parent
from hil.core.realtime import FIFO, MEMORY, RealTime


def main() -> None:
    """Request the privileges."""
    parent = Parent()
    with RealTime() as realtime:
        refused = {grant.name: grant.detail for grant in realtime.refused()}
    parent.send(fifo_refused=refused.get(FIFO, ""), memory_lock_refused=refused.get(MEMORY, ""))


if __name__ == "__main__":
    main()
