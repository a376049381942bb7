"""``hil operators``: keys of the operators of a console."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from hil.cli.options import Names, refuse
from hil.cli.output import print_columns
from hil.errors import BadInput, Problem

if TYPE_CHECKING:
    from hil.core.operator_keys import Signature

_FILE = "operators.toml"

app = App(name="operators")


@app.command(help="Make a key for an operator, and enter it into the console's file.")
def add(
    name: str,
    /,
    *,
    rights: Literal["watch", "confirm", "command"] = "command",
    address: Names = (),
    operators: str = _FILE,
    out: str | None = None,
) -> int:
    """Make a key for an operator, and enter it into the console's file.

    Parameters
    ----------
    name
        Name of the operator, as pages, recordings and records show it.
    rights
        watch: watches, stops and holds. confirm: confirms as the second person as well. command: all.
    address
        Address from which the key is accepted; may be given more than once. By default any.
    operators
        File of hil console --operators; it is created if necessary.
    out
        File for the operator, who gives it to the page; default: NAME.key.
    """
    from hil.core.operator_keys import name_problem, new_key, read_operators, write_key, write_operators

    keys = read_operators(operators) if Path(operators).exists() else {}
    file = Path(out or f"{name.replace(' ', '-')}.key")
    problems = [Problem("NAME", "", text)] if (text := name_problem(name)) else []
    if any(key.name.casefold() == name.casefold() for key in keys.values()):
        problems.append(Problem(operators, name, "is there already: remove its table first to replace the key"))
    if file.exists():
        problems.append(Problem("--out", "", f"{file}: exists already"))
    refuse(problems)
    key = new_key(name, rights, address)
    write_key(file, key)
    write_operators(operators, {**keys, key.id: key})
    print(f"{file}: key {key.id} of {name}, who may {rights}: give it to this person alone")  # noqa: T201
    return 0


@app.command(name="list", help="List the operators of a console with their keys' names and rights.")
def list_operators(operators: str = _FILE, /) -> int:
    """List the operators of a console with their keys' names and rights.

    Parameters
    ----------
    operators
        File of hil console --operators.
    """
    from hil.core.operator_keys import read_operators

    rows = [
        (key.name, key.id, key.rights, ", ".join(key.addresses) or "any") for key in read_operators(operators).values()
    ]
    print_columns(("operator", "key", "rights", "addresses"), rows, left=(0, 1, 2, 3))
    return 0


@app.command(help="Verify who signed rig files and records of preflights and proof tests.")
def verify(files: Annotated[list[str], Parameter(negative=())], /, *, operators: str = _FILE) -> int:
    """Verify who signed rig files and records of preflights and proof tests.

    Exit code 1 if one is not sealed by a key of the file.

    Parameters
    ----------
    files
        Rig files with a sign-off (*.toml), records of preflights and proof tests (*.json).
    operators
        File of hil console --operators.
    """
    from hil.core.operator_keys import read_operators

    keys, failed = read_operators(operators), False
    for name in files:
        for what, signature, record in _signatures(name):
            problem = signature.problem(record, keys)
            failed = failed or bool(problem)
            print(f"{'FAIL' if problem else 'PASS'} {name}: {what}: {problem or f'sealed by {signature.by}'}")  # noqa: T201
    return int(failed)


def _signatures(name: str) -> list[tuple[str, Signature, list[Any]]]:
    from hil.checks.signed_record import read_signed, signature_of
    from hil.config.load import load_rig
    from hil.parts.commissioning.sign_off import signatures

    if name.endswith(".json"):
        return [("record", *signature_of(read_signed(Path(name))))]
    sign_off = load_rig(name).value.sign_off
    signed = [] if sign_off is None else list(signatures(sign_off))
    if not signed:
        raise BadInput.single(name, "rig.sign_off", "is missing: nothing is signed")
    return signed
