"""Data sheets of drives that differ from the shipped one."""

from __future__ import annotations

import re
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


def with_pdos(folder: Path, *pdos: str, device: str = "") -> Path:
    """Return the path of the shipped data sheet with ``pdos`` in place of its own; device: options of [DeviceInfo]."""
    text = re.sub(r"(?ms)^\[1[468A]0[0-9](sub.)?\]\n.*?(?=^\[)", "", SHIPPED.read_text())
    path = folder / "drive.eds"
    path.write_text(text.replace("[DeviceInfo]\n", f"[DeviceInfo]\n{device}") + "\n\n" + "\n".join(pdos))
    return path


def pdo(number: int, function: int, *mapped: int, fixed: str = "", transmission: int = 1) -> str:
    """Return the sections of a PDO by its parameter index; fixed: "identifier" and "mapping", what is read-only."""
    options = {
        f"{number:X}sub1": (7, "identifier", f"$NODEID+0x{function:X}"),
        f"{number:X}sub2": (5, "", str(transmission)),
        f"{number + 0x200:X}sub0": (5, "mapping", str(len(mapped))),
        **{f"{number + 0x200:X}sub{k}": (7, "mapping", f"0x{entry:X}") for k, entry in enumerate(mapped, 1)},
    }
    return "\n".join(
        f"[{name}]\nDataType={kind}\nAccessType={'ro' if use and use in fixed else 'rw'}\nDefaultValue={default}\n"
        for name, (kind, use, default) in options.items()
    )
