"""``hil console``: the page from which a session at the bench is seen and commanded."""

from __future__ import annotations

import datetime
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

from hil.config.console import OnLoss
from hil.errors import BadInput

_NEEDED = ("fastapi", "uvicorn", "websockets")


def console_command(
    host: str,
    port: int,
    token_file: str | None,
    rig_name: str,
    scenario_name: str,
    seed: int,
    duration_s: float | None,
    speed: float,
    settings: Sequence[str],
    on_loss: OnLoss | None,
    record: str | None,
) -> int:
    """Do ``hil console``; return its exit code. Raises BadInput before anything listens."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise BadInput.single("hil console", "", f"{', '.join(missing)} missing: pip install 'hil-bench[console]'")

    from hil.cli.run import check_options
    from hil.console.serve import listen, read_token, serve
    from hil.console.session import Choice

    check_options(seed, duration_s, speed, None)
    choice = Choice(
        scenario=scenario_name,
        rig=rig_name,
        seed=seed,
        duration_s=duration_s,
        speed=speed,
        settings=tuple(settings),
        on_loss=on_loss,
        record=None if record is None else str(Path(record).absolute()),
    )
    choice.job()
    token = None if token_file is None else read_token(token_file)
    with listen(host, port, token) as listener:
        shown = f"[{host}]" if ":" in host else host
        _say(f"console on http://{shown}:{listener.getsockname()[1]}/")
        try:
            serve(choice, listener, host, token, _log)
        except KeyboardInterrupt:
            _say("console closed")
    return 0


def _log(text: str) -> None:
    _say(f"{datetime.datetime.now().astimezone():%H:%M:%S} {text}")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201
