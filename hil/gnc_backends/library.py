"""GNC binaries of a scenario: a shared library or an FMU, in this process or in one of its own."""

from __future__ import annotations

from typing import Final

from hil.config.scenario import GncConfig
from hil.gnc_backends import fmu, shared_library
from hil.gnc_backends.backend_registry import backend_file
from hil.gnc_backends.shared_library import GncLibrary, Library, digest_of

_KEYS: Final = {True: fmu.KEY, False: shared_library.KEY}


def key_of(gnc: GncConfig) -> str:
    """Return the key of the scenario that names the binary."""
    return _KEYS[gnc.fmu is not None]


def open_library(gnc: GncConfig, source: str = "--set") -> GncLibrary | None:
    """Return the binary that ``gnc`` names, None for the built-in GNC. source: for messages. Raises BadInput."""
    if gnc.fmu is not None:
        if gnc.fmu_process:
            from hil.gnc_backends.isolated import IsolatedFmu

            return IsolatedFmu(gnc, source)
        return fmu.FmuLibrary(gnc, source)
    return None if gnc.library is None else Library(gnc.library, source)


def binary_digest(gnc: GncConfig) -> str:
    """Return the digest of the files of the GNC: SHA-256 of its binary, of the mapping if there is one, of backends."""
    backends = [backend_file(name, part) for part, name in gnc.foreign.items()]
    files = [path for path in (gnc.binary, gnc.fmu_mapping, *backends) if path is not None]
    return " ".join(digest_of(path) for path in files)
