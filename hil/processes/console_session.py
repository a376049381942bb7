"""Process of one console session: the loop of a run that is operated from the console; nothing of the web is in it.

``python -m hil.processes.console_session`` is started by ``SessionProcess``. It outlives a console that dies, and then
brings the bench to a standstill.
"""

import signal
import socket

from hil.console.session import Choice, run_session
from hil.core.child_process import Parent


def main() -> None:
    """Run the session; SIGINT and SIGTERM interrupt it."""
    parent = Parent(when_orphaned=None, on_interrupt=signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    choice = Choice.model_validate(parent.configuration["choice"], strict=False)
    with socket.socket(fileno=parent.configuration["channel"]) as channel:
        run_session(choice, channel)


if __name__ == "__main__":
    main()
