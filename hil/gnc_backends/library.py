"""GNC binaries of a scenario: a shared library or an FMU, in this process or in one of its own."""

from __future__ import annotations

from typing import Final

from hil.config.scenario import GncConfig
from hil.core.part import provided
from hil.gnc_backends import shared_library
from hil.gnc_backends.backend_registry import backend_file
from hil.gnc_backends.shared_library import GncLibrary, Library, digest_of

_KEYS: Final = {True: "gnc.fmu", False: shared_library.KEY}


def key_of(gnc: GncConfig) -> str:
    """Return the key of the scenario that names the binary."""
    return _KEYS[gnc.fmu is not None]


def open_library(gnc: GncConfig, source: str = "--set") -> GncLibrary | None:
    """Return the binary that ``gnc`` names, None for the built-in GNC. source: for messages. Raises BadInput."""
    if gnc.fmu is not None:
        opened: GncLibrary = provided("gnc.fmu", source)(gnc, source)
        return opened
    return None if gnc.library is None else Library(gnc.library, source)


def binary_digest(gnc: GncConfig) -> str:
    """Return the digest of the files of the GNC: SHA-256 of its binary, of the mapping if there is one, of backends."""
    backends = [backend_file(name, part) for part, name in gnc.foreign.items()]
    files = [path for path in (gnc.binary, gnc.fmu_mapping, *backends) if path is not None]
    return " ".join(digest_of(path) for path in files)
