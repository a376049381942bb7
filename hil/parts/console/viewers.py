"""Live viewers of a console in addition to its page: each is declared by a part, ``Part.viewers``."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, NamedTuple, Protocol

from hil.core.part import declared, imported, parts
from hil.errors import BadInput
from hil.parts.console.strangers import Access

if TYPE_CHECKING:
    from hil.parts.console.service import ConsoleService

Log = Callable[[str], None]


class Viewer(Protocol):
    """Server of one kind of viewers, made by ``factory(port, code, log)``; raises BadInput if it cannot listen.

    port: on this computer, 0 for any free one. code: required of a viewer that takes the command, None if none may.
    address: at which viewers connect. notes: further lines for the operator.
    """

    address: str

    @property
    def notes(self) -> Sequence[str]: ...

    def attach(self, service: ConsoleService) -> None:
        """Serve the viewers by ``service``, in the present event loop."""

    def tick(self) -> None:
        """Send what has changed; called about 20 times per second. It must not wait."""

    def close(self) -> None:
        """End the server."""


class ViewerOption(NamedTuple):
    """A viewer that the operator has asked for: the option, its kind and its port."""

    option: str
    name: str
    port: int


def viewer_option(text: str) -> ViewerOption:
    """Return the viewer of ``--viewer NAME=PORT``. Raises BadInput."""
    name, _, port = text.partition("=")
    if not name or not port.isdecimal():
        raise BadInput.single("--viewer", "", f"{text}: must look like foxglove=8766")
    return ViewerOption("--viewer", name, int(port))


@contextmanager
def opened_viewers(asked: Sequence[ViewerOption], access: Access, log: Log) -> Iterator[tuple[list[Viewer], list[str]]]:
    """Give the viewers and the lines that introduce them. Raises BadInput for a viewer of no installed part.

    The token, or a new code, is required for the command; where operators have keys, viewers watch.
    """
    code = None if access.operators else access.token or secrets.token_hex(8)
    shown = f"; code to take the command: {code}" if code and access.token is None else ""
    viewers: list[Viewer] = []
    lines: list[str] = []
    with ExitStack() as stack:
        for option, name, port in asked:
            if (path := declared("viewers").get(name)) is None:
                reasons = "".join(f"; {problem}" for problem in parts().problems)
                text = f"needs package hil-bench-{name}, which is not installed: pip install hil-bench-{name}{reasons}"
                raise BadInput.single(option, "", text)
            viewer: Viewer = stack.enter_context(closing(imported(path)(port, code, log)))
            viewers.append(viewer)
            lines += [f"{name} on {viewer.address}{shown}", *viewer.notes]
        yield viewers, lines
