"""Process of one console session: the loop of a run that is operated from the console; nothing of the web is in it.

``python -m hil.parts.console.console_session`` is started by ``SessionProcess``. It outlives a console that dies, and
then brings the bench to a standstill.
"""

import datetime
import signal
import socket
from typing import Any

from hil.checks.signed_record import DUE_DAYS, write_proof
from hil.core.child_process import Parent
from hil.core.files import write_text
from hil.core.operator_commands import StopCommanded
from hil.core.operator_keys import read_operators
from hil.core.part import provided
from hil.drivers.remote.io_layout import WATCHDOG
from hil.errors import BenchError
from hil.loop.runner import COMPLETED, STOPPED_BY_OPERATOR, Runner
from hil.parts.commissioning.prompt import StepFailed
from hil.parts.commissioning.sign_off import as_toml, free_file
from hil.parts.commissioning.steps import Commissioning, CommissioningPlan
from hil.parts.console.session import Choice, CommissioningOperator, run_session
from hil.parts.wires.wired import WiredBench
from hil.session.build import Job


def main() -> None:
    """Run the session; SIGINT and SIGTERM interrupt it."""
    parent = Parent(when_orphaned=None, on_interrupt=signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    choice = Choice.model_validate(parent.configuration["choice"], strict=False)
    with socket.socket(fileno=parent.configuration["channel"]) as channel:
        run_session(choice, channel, commission)


def commission(
    choice: Choice, job: Job, bench: WiredBench, runner: Runner, operator: CommissioningOperator
) -> dict[str, Any]:
    """Commission all axes of the rig with the technician at the page, and write its sign-off next to its file."""
    rig, emulated = job.rig.value, None
    if bench.board is not None:
        emulated = provided("rig.kind=emulated: operator")(bench.board, bench.addresses)
    steps = Commissioning(
        runner,
        rig,
        operator,
        CommissioningPlan(range(6)),
        emulated if rig.has_io else None,
        emulated.position if emulated is not None else None,
        bench.pids.get(WATCHDOG),
    )
    ended: dict[str, Any] = {"faults": [], "mode": "off", "accepted": None, "passed": None}
    try:
        findings = steps.run()
    except StopCommanded:
        return ended | {"stop": f"{STOPPED_BY_OPERATOR}: not signed"}
    except (BenchError, StepFailed) as fault:
        return ended | {"stop": f"{fault}: not signed"}
    assert choice.signed_by is not None
    key = read_operators(choice.operators)[choice.signed_by.key] if choice.operators else None
    path, base = free_file(choice.rig)
    now = datetime.datetime.now().astimezone()
    write_text(as_toml(findings, rig, base, key or choice.signed_by.name, now.date().isoformat()), str(path))
    if rig.kind == "hardware":
        write_proof(str(path), now.timestamp(), DUE_DAYS, findings.proved, key or choice.signed_by.name)
    operator.show(f"{path}: the rig is signed off")
    return ended | {"stop": COMPLETED, "signed": str(path)}


if __name__ == "__main__":
    main()
