"""Controller of a rig file in a process of its own, with an operator at its input.

``python -m tests.support.attended_controller RIG [SETTING ...]`` prints a line for each process, alarm and mode, and
executes the commands in its input, a line each (``home``, ``arm``, ``jog rails.x 1``).
"""

from __future__ import annotations

import sys
import threading
import time

from hil.core.operator_commands import Operator, OperatorCommand
from hil.session import build
from hil.session.warm_up import warm_up
from tests.support.run_settings import make_job

JOG_PERIOD_S = 0.05


def obey(operator: Operator) -> None:
    """Execute the lines of standard input."""
    for line in sys.stdin:
        command, *words = line.split()
        if command == "jog":
            threading.Thread(target=jog, args=(operator, words[0], int(words[1])), daemon=True).start()
        else:
            operator.submit(OperatorCommand(command))


def jog(operator: Operator, axis: str, direction: int) -> None:
    """Hold a jog key until the process ends."""
    while True:
        operator.jog(axis, direction)
        time.sleep(JOG_PERIOD_S)


def send(line: str) -> None:
    """Write one line to standard output."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Run one session."""
    rig, *settings = sys.argv[1:]
    job = make_job(60.0, settings, rig=rig)
    warm_up(job)
    operator = Operator((), attended=True)
    with build.runner(job, announce=send, operator=operator) as runner:
        runner.safety.alarms.raised.subscribe(lambda alarm: send(f"alarm {alarm.text}"))
        runner.safety.modes.history.subscribe(lambda mode: send(f"mode {mode.value}"))
        threading.Thread(target=obey, args=(operator,), daemon=True).start()
        send(f"stop {runner.run().stop}")


if __name__ == "__main__":
    main()
