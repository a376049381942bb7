"""Documentation, docstrings, comments and displayed texts use the field's terms (tests/support/vocabulary.py)."""

from pathlib import Path

import pytest

from tests.support import vocabulary


@pytest.mark.parametrize("path", vocabulary.ALL)
def test_texts_use_the_terms_of_the_field(path: str) -> None:
    assert not [str(finding) for finding in vocabulary.findings([vocabulary.ROOT / path])]


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("page.md", "The bench says so.", ["1: say"]),
        ("page.md", "`says` is [a link](says.md)\n```sh\nsays # says\n```", ["3: say"]),
        ("CHANGELOG.md", "## next\nsays\n## 1.0\nsays", ["2: say"]),
        (
            "module.py",
            '"""Module.\n\nIt says so.\n"""\nsays = "says"\ntext = f"it {says} says"  # told',
            ["3", "6", "6"],
        ),
        ("rig.toml", "says = 1 # says", ["1: say"]),
        ("page.js", 'const says = "says"; // told\nshow(`it says ${1}`);', ["1: tell", "2: say"]),
    ],
)
def test_prose_is_checked_and_code_is_not(tmp_path: Path, name: str, text: str, found: list[str]) -> None:
    (tmp_path / name).write_text(text)
    lines = sorted(str(finding).removeprefix(f"{tmp_path / name}:") for finding in vocabulary.findings([tmp_path]))
    assert len(lines) == len(found)
    assert all(line.startswith(start) for line, start in zip(lines, found, strict=True))


def test_names_of_tests_are_checked_and_their_literals_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vocabulary, "TESTS", tmp_path)
    (tmp_path / "test_module.py").write_text('def test_nobody_is_told() -> None:\n    assert "it says so"\n')
    assert [(found.line, found.word) for found in vocabulary.findings([tmp_path])] == [(1, "whoever"), (1, "tell")]
