"""Keys of operators: a secret of each person, the proof that a client has it, and the file with which a console checks.

A key is 256 random bits. The operator has it in a file of its own; the console's file has those of all operators with
their rights. Both are readable by their owner only. A client proves its key by the HMAC-SHA-256 of a challenge that is
used once, so that the key is never sent. The console's file is enough to act as any operator.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from hil.core.files import KIB, parse_toml, read_private_text, write_text
from hil.errors import BadInput, Problem

Rights = Literal["watch", "confirm", "command"]
"""watch: watches, stops and holds. confirm: confirms as the second person as well. command: all."""
RIGHTS: Final[tuple[str, ...]] = get_args(Rights)
NAME_MAX: Final = 24
_FILE_BYTES: Final = 64 * KIB
_SECRET: Final = re.compile(r"[0-9a-f]{64}")
_NAME: Final = re.compile(rf"\w(?:[\w .-]{{0,{NAME_MAX - 2}}}\w)?")
_PROOF: Final = "hil operator key 1"


@dataclass(frozen=True, slots=True)
class OperatorKey:
    """Key of one operator. secret: 64 hexadecimal digits. addresses: from which it is accepted, () for any."""

    name: str
    secret: str
    rights: str = "command"
    addresses: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Name of the key in records: 16 hexadecimal digits, from which the key cannot be computed."""
        return hashlib.sha256(bytes.fromhex(self.secret)).hexdigest()[:16]

    def proof(self, challenge: str, host: str, client: str) -> str:
        """Return the proof for ``challenge`` at the console ``host``, as the client names it, by ``client``, a secret
        of its page: hexadecimal HMAC-SHA-256."""
        text = "\n".join((_PROOF, host, challenge, client))
        return hmac.new(bytes.fromhex(self.secret), text.encode(errors="replace"), hashlib.sha256).hexdigest()

    def seal(self, text: str) -> str:
        """Return the HMAC-SHA-256 of a record that the operator signs, hexadecimal."""
        return hmac.new(bytes.fromhex(self.secret), f"hil record 1\n{text}".encode(), hashlib.sha256).hexdigest()


@dataclass(frozen=True, slots=True)
class Signature:
    """Signature under a record: name, id of the key, and seal, "" for a name that nothing proves."""

    by: str
    key: str = ""
    seal: str = ""

    @classmethod
    def of(cls, signatory: OperatorKey | str, record: Sequence[Any]) -> Signature:
        """Return the signature of a key, or the name alone, under ``record``, plain values."""
        if isinstance(signatory, str):
            return cls(signatory)
        return cls(signatory.name, signatory.id, signatory.seal(_sealed(signatory.name, record)))

    def problem(self, record: Sequence[Any], operators: Mapping[str, OperatorKey]) -> str:
        """Return why ``record`` is not signed by a key of ``operators``, "" if it is."""
        if not self.key:
            return f"signed by the name {self.by}, without a key"
        key = operators.get(self.key)
        if key is None:
            return f"signed with the key {self.key}, which is not in the file"
        if not hmac.compare_digest(key.seal(_sealed(self.by, record)).encode(), self.seal.encode(errors="replace")):
            return f"not sealed by the key of {key.name}: the record or its signature was changed"
        return ""


def _sealed(name: str, record: Sequence[Any]) -> str:
    return json.dumps([name, *record])


def new_challenge() -> str:
    """Return a challenge that was never used."""
    return secrets.token_hex(32)


def new_key(name: str, rights: str = "command", addresses: tuple[str, ...] = ()) -> OperatorKey:
    """Return a new key."""
    return OperatorKey(name, secrets.token_hex(32), rights, addresses)


def read_key(path: str | Path) -> OperatorKey:
    """Return the key in the operator's file; raises BadInput."""
    table = _table(path)
    if table.keys() != {"name", "secret"}:
        raise BadInput.single(str(path), "", "not the key of an operator: it must have name and secret, nothing else")
    problems = _problems(str(path), "", table["name"], table)
    if problems:
        raise BadInput(problems)
    return OperatorKey(table["name"], table["secret"])


def read_operators(path: str | Path) -> dict[str, OperatorKey]:
    """Return the keys in the console's file by their ids; raises BadInput."""
    problems: list[Problem] = []
    keys: dict[str, OperatorKey] = {}
    names: dict[str, str] = {}
    for name, table in _table(path).items():
        wrong = _problems(str(path), f"{name}.", name, table)
        if twin := names.setdefault(name.casefold(), name) != name and names[name.casefold()]:
            wrong.append(Problem(str(path), name, f"differs from {twin} in capitals only: give another name"))
        if not wrong:
            key = OperatorKey(name, table["secret"], table.get("rights", "command"), tuple(table.get("addresses", ())))
            if key.id in keys:
                wrong.append(Problem(str(path), name, f"has the key of {keys[key.id].name}: each person has another"))
            keys[key.id] = key
        problems += wrong
    if not keys and not problems:
        problems.append(Problem(str(path), "", "has no operators: hil operators add NAME"))
    if problems:
        raise BadInput(problems)
    return keys


def write_operators(path: str | Path, keys: dict[str, OperatorKey]) -> None:
    """Write the console's file; raises BadInput."""
    lines = ["# Operators of hil console. This file is enough to act as any of them."]
    for key in keys.values():
        lines += ["", f"[{json.dumps(key.name, ensure_ascii=False)}]", f'secret = "{key.secret}"']
        lines += [f'rights = "{key.rights}"']
        lines += [f"addresses = {json.dumps(list(key.addresses))}"] if key.addresses else []
    write_text("\n".join(lines) + "\n", path, mode=0o600)


def write_key(path: str | Path, key: OperatorKey) -> None:
    """Write the operator's file; raises BadInput."""
    text = f'name = {json.dumps(key.name, ensure_ascii=False)}\nsecret = "{key.secret}"\n'
    write_text(text, path, mode=0o600)


def name_problem(name: object) -> str:
    """Return what is wrong with the name of an operator, "" if nothing is."""
    if isinstance(name, str) and _NAME.fullmatch(name):
        return ""
    return f"{name!r}: allowed are letters, digits, blanks, dots and hyphens, at most {NAME_MAX}"


def _table(path: str | Path) -> dict[str, Any]:
    text = read_private_text(Path(path), _FILE_BYTES)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise BadInput.single(str(path), "", f"not TOML: {error}") from error


def _problems(source: str, prefix: str, name: object, table: object) -> list[Problem]:
    """Return the problems of one operator's table."""
    if not isinstance(table, dict):
        return [Problem(source, prefix.rstrip("."), "must be a table with secret, rights and addresses")]
    wrong = [Problem(source, prefix.rstrip(".") or "name", text)] if (text := name_problem(name)) else []
    unknown = table.keys() - {"name", "secret", "rights", "addresses"}
    wrong += [Problem(source, f"{prefix}{key}", "unknown: allowed are secret, rights, addresses") for key in unknown]
    secret, rights, addresses = table.get("secret"), table.get("rights", "command"), table.get("addresses", [])
    if not (isinstance(secret, str) and _SECRET.fullmatch(secret)):
        wrong.append(Problem(source, f"{prefix}secret", "must have 64 hexadecimal digits: hil operators add writes it"))
    if rights not in RIGHTS:
        wrong.append(Problem(source, f"{prefix}rights", f"{rights!r}: allowed are {', '.join(RIGHTS)}"))
    if not (isinstance(addresses, list) and all(isinstance(each, str) for each in addresses)):
        wrong.append(Problem(source, f"{prefix}addresses", f"{addresses!r}: must be a list of texts"))
    return wrong
