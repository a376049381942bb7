"""GNC binaries of a scenario: a shared library or an FMU, in this process or in one of its own."""

from __future__ import annotations

from typing import Final

from hil.config.scenario import GncConfig
from hil.core.part import provided
from hil.errors import BadInput
from hil.gnc_backends.backend import WHOLE, Backend
from hil.gnc_backends.backend_registry import backend_file, digest_of
from hil.gnc_backends.python_backend import PythonBackend

_KEYS: Final = {True: "gnc.fmu", False: "gnc.library"}


def key_of(gnc: GncConfig) -> str:
    """Return the key of the scenario that names the binary."""
    return _KEYS[gnc.fmu is not None]


def open_library(
    gnc: GncConfig, source: str = "--set", own: object | None = None, copies: bool = False
) -> Backend | None:
    """Return the whole GNC that is elsewhere, None for the built-in one. Raises BadInput. source: for messages.

    It is ``own``, an object of the caller, of which each instance is a copy if ``copies``, or the binary of ``gnc``.
    """

    def refuse(what: str) -> BadInput:
        return BadInput.single(source, key_of(gnc), f'"{gnc.binary}": {what}')

    if own is not None:
        return PythonBackend(own, WHOLE, refuse, copies)
    if gnc.binary is None:
        return None
    if gnc.fmu is None:
        from hil.gnc_backends.shared_library import LibraryBackend  # of few runs

        return LibraryBackend(gnc.binary, WHOLE, refuse)
    opened: Backend = provided("gnc.fmu", source)(gnc, refuse)
    return opened


def binary_digest(gnc: GncConfig) -> str:
    """Return the digest of the files of the GNC: SHA-256 of its binary, of the mapping if there is one, of backends."""
    backends = [backend_file(name, part) for part, name in gnc.foreign.items()]
    files = [path for path in (gnc.binary, gnc.fmu_mapping, *backends) if path is not None]
    return " ".join(digest_of(path) for path in files)
