"""Keys of operators: files for their owner alone, one key and one name each, and proofs for one challenge."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from hil.cli.main import execute
from hil.core.operator_keys import (
    OperatorKey,
    new_challenge,
    new_key,
    read_key,
    read_operators,
    write_key,
    write_operators,
)
from hil.errors import BadInput

ANN = OperatorKey("Ann \u00d6", "a1" * 32, "command", ("192.168.1.30",))
BOB = OperatorKey("bob", "b2" * 32, "confirm")


def test_files_are_for_their_owner_and_read_back_what_was_written(tmp_path: Path) -> None:
    file, key = tmp_path / "operators.toml", tmp_path / "ann.key"
    write_operators(file, {each.id: each for each in (ANN, BOB)})
    write_key(key, ANN)
    assert {stat.S_IMODE(path.stat().st_mode) for path in (file, key)} == {0o600}
    assert read_operators(file) == {ANN.id: ANN, BOB.id: BOB}
    assert read_key(key) == OperatorKey(ANN.name, ANN.secret)
    for path, read in ((file, read_operators), (key, read_key)):
        path.chmod(0o640)
        with pytest.raises(BadInput, match=r"readable by other users, mode 640: chmod 600"):
            read(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has no operators: hil operators add NAME"),
        ("ann = 1", "ann: must be a table with secret, rights and addresses"),
        ('[ann]\nsecret = "a1"', "ann.secret: must have 64 hexadecimal digits"),
        ('[ann]\nsecret = "S"\nrights = "all"', "ann.rights: 'all': allowed are watch, confirm, command"),
        ('[ann]\nsecret = "S"\naddresses = "any"', "ann.addresses: 'any': must be a list of texts"),
        ('[ann]\nsecret = "S"\nright = "all"', "ann.right: unknown: allowed are secret, rights, addresses"),
        ('["an\\u202en"]\nsecret = "S"', "allowed are letters, digits, blanks, dots and hyphens, at most 24"),
        ('[ann]\nsecret = "S"\n[Ann]\nsecret = "T"', "Ann: differs from ann in capitals only"),
        ('[ann]\nsecret = "S"\n[bob]\nsecret = "S"', "bob: has the key of ann: each person has another"),
        ("[ann", "not TOML"),
    ],
)
def test_file_that_leaves_open_who_is_who_is_refused_by_file_key_and_allowed_value(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "operators.toml"
    path.touch(mode=0o600)
    path.write_text(text.replace('"S"', f'"{ANN.secret}"').replace('"T"', f'"{BOB.secret}"'))
    with pytest.raises(BadInput) as raised:
        read_operators(path)
    (line,) = str(raised.value).splitlines()
    assert line.startswith(str(path))
    assert reason in line


def test_proof_fits_one_key_one_challenge_one_console_and_one_page() -> None:
    asked = (new_challenge(), "bench:8765", "page" * 4)
    others = [(new_challenge(), *asked[1:]), (asked[0], "evil:8765", asked[2]), (*asked[:2], "other" * 4)]
    assert ANN.proof(*asked) == ANN.proof(*asked)
    assert len({ANN.proof(*asked), BOB.proof(*asked), *(ANN.proof(*other) for other in others)}) == 5
    assert ANN.secret not in ANN.proof(*asked) + ANN.id


def test_new_keys_differ() -> None:
    assert len({new_key("ann").secret for _ in range(100)}) == 100


def test_command_enters_each_operator_once_and_keeps_keys_that_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert execute(["operators", "add", "ann lee", "--address", "192.168.1.30"]) == 0
    ann = read_key("ann-lee.key")
    assert execute(["operators", "add", "bob", "--rights", "watch"]) == 0
    assert execute(["operators", "list"]) == 0
    assert capsys.readouterr().out.count("ann lee") == 2
    assert execute(["operators", "add", "Ann Lee", "--out", "ann-lee.key"]) == 2
    refused = capsys.readouterr().err
    assert "operators.toml: Ann Lee: is there already" in refused
    assert "ann-lee.key: exists already" in refused
    entered = {(key.name, key.rights, key.addresses) for key in read_operators("operators.toml").values()}
    assert entered == {("ann lee", "command", ("192.168.1.30",)), ("bob", "watch", ())}
    assert ann.id in read_operators("operators.toml")
