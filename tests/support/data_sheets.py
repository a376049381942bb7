"""Data sheets of drives that differ from the shipped one."""

from __future__ import annotations

from pathlib import Path

from hil.drivers.turntable.cia402.eds import SHIPPED


def altered(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return the path of the shipped data sheet with ``changes``, (old, new)."""
    text = SHIPPED.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "drive.eds"
    path.write_text(text)
    return path


def section(index: str) -> str:
    """Return one section of the shipped EDS."""
    text = SHIPPED.read_text()
    start = text.index(f"[{index}]")
    return text[start:].split("\n\n")[0]
