"""Signed records next to a rig file: JSON tables with the name of their author, the key, and a seal over all values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from hil.core.files import KIB, parse_json, read_text
from hil.core.operator_keys import OperatorKey, Signature
from hil.core.text_files import write_text
from hil.errors import BadInput

_SIGNATURE: Final = ("by", "key", "seal")
_BYTES: Final = 64 * KIB


def write_signed(record: Mapping[str, Any], path: Path, by: OperatorKey | str) -> None:
    """Write ``record`` with its signature to ``path``. by: key, or a name that nothing proves. Raises BadInput."""
    signed = {**record, **asdict(Signature.of(by, _sealed(record)))}
    write_text(json.dumps(signed, indent=1) + "\n", path)


def read_signed(path: Path) -> dict[str, Any]:
    """Return the record at ``path`` with its signature. Raises BadInput."""
    try:
        record = parse_json(read_text(path, _BYTES))
    except ValueError as error:
        raise BadInput.single(str(path), "", f"not JSON: {error}") from error
    if not isinstance(record, dict) or not all(isinstance(record.get(name), str) for name in _SIGNATURE):
        raise BadInput.single(str(path), "", "not a signed record: by, key and seal are missing")
    return record


def signature_of(record: Mapping[str, Any]) -> tuple[Signature, list[Any]]:
    """Return the signature of a record, and the values that it seals."""
    return Signature(*(record[name] for name in _SIGNATURE)), _sealed(record)


def _sealed(record: Mapping[str, Any]) -> list[Any]:
    return sorted([key, value] for key, value in record.items() if key not in _SIGNATURE)
