"""Identity of the installed program, and of what its numbers depend on.

A campaign sends the text of this module to the workers of a cluster: it needs no more than the standard library of any
Python 3, and not the program itself.
"""

import hashlib
import importlib.util
import os
import sys

PACKAGES = ("numpy", "scipy", "numba", "llvmlite")  # they draw random words and generate code


def program():
    # type: () -> dict[str, str]
    """Return versions and the digest of the program's sources; "none" for what is not installed."""
    identity = {"hil": _version("hil-bench"), "digest": "none"}
    spec = importlib.util.find_spec("hil")
    if spec is None or not spec.submodule_search_locations:
        identity["hil"] = "none"
    else:
        identity["digest"] = _digest(next(iter(spec.submodule_search_locations)))
    identity["python"] = f"{sys.version_info[0]}.{sys.version_info[1]}"
    identity.update({name: _version(name) for name in PACKAGES})
    return identity


def _version(name):
    # type: (str) -> str
    try:
        from importlib.metadata import PackageNotFoundError, version
    except ImportError:  # before Python 3.8
        return "unknown"
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _digest(folder):
    # type: (str) -> str
    """Return the digest of the names and contents of all Python files in ``folder``."""
    digest = hashlib.sha256()
    for place, folders, names in sorted(os.walk(folder)):
        folders.sort()
        for name in sorted(names):
            if name.endswith(".py"):
                path = os.path.join(place, name)
                with open(path, "rb") as file:
                    content = hashlib.sha256(file.read()).hexdigest()
                digest.update(f"{os.path.relpath(path, folder)} {content}\n".encode())
    return digest.hexdigest()[:16]
