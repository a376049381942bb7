"""Recorder process of a paced run.

``python -m hil.recording.recorder_process`` is started by ``hil.recording.session``. It outlives its parent: the file
of a run whose process has died is closed in order.
"""

import signal

from hil.core.child_process import Parent
from hil.recording.recorder import run_child


def main() -> None:
    """Record until the parent sends the end of the run or dies."""
    parent = Parent(when_orphaned=None)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the parent sends the end of the run first
    run_child(parent)


if __name__ == "__main__":
    main()
