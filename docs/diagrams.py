"""Diagrams of the architecture pages, as SVG.

``python -m docs.diagrams`` writes them; a test compares them with the import contract and the files that they name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from docs import package_pages

ROOT: Final = Path(__file__).resolve().parents[1]
FOLDER: Final = ROOT / "docs" / "pictures"

INK, LINE, PAPER = "#1f2933", "#52606d", "#ffffff"
BLUE, ORANGE, GREEN, GREY = "#dbeafe", "#ffedd5", "#dcfce7", "#f1f5f9"


class Box(NamedTuple):
    """Rectangle with lines of text, the first one bold; px."""

    x: float
    y: float
    width: float
    height: float
    text: tuple[str, ...]
    fill: str = GREY

    @property
    def right(self) -> float:
        return self.x + self.width

    @property
    def bottom(self) -> float:
        return self.y + self.height


def layers() -> str:
    """Return the packages in the layers of the import contract; pyproject.toml names the layers in comments."""
    parts = []
    for number, (name, packages) in enumerate(package_pages.layers()):
        y = 10 + 44 * number
        parts.append(_text(10, y + 22, name, size=13))
        x = 360.0
        for package in packages:
            width = 20 + 8.2 * len(package)
            parts.append(_box(Box(x, y, width, 34, (package,), BLUE if number % 2 else GREEN)))
            x += width + 10
    bottom = 10 + 44 * len(package_pages.layers())
    parts.append(_arrow([(345, 12), (345, bottom - 14)]))
    parts.append(
        _text(10, bottom + 14, "Imports run downwards only; packages of one layer do not import each other.", size=12)
    )
    return _svg(830, bottom + 28, parts)


def processes() -> str:
    """Return the processes of a run on a rig with wires and what passes between them."""
    page = Box(10, 20, 130, 56, ("operator page", "browser"))
    console = Box(190, 20, 140, 56, ("hil console", "web server"))
    loop = Box(390, 20, 190, 112, ("loop", "cycle, GNC, truth", "SCHED_FIFO 80"), ORANGE)
    io = Box(390, 200, 190, 76, ("I/O process", "drivers", "SCHED_FIFO 60"), ORANGE)
    devices = Box(390, 344, 190, 76, ("rails, turntable, VMU", "hardware, or emulators", "one process each"), GREEN)
    watchdog = Box(690, 200, 190, 76, ("watchdog", "digital lines", "SCHED_FIFO 60"), ORANGE)
    relay = Box(690, 344, 190, 76, ("I/O coupler, safety relay", "emergency stop,", "torque of the drives"), GREEN)
    recorder = Box(690, 20, 190, 46, ("recorder", "MCAP file, catalogue"))
    monitor = Box(690, 86, 190, 46, ("docking monitor", "low priority"))
    gnc = Box(190, 200, 140, 76, ("GNC process", "hil gnc or yours", "(hil dss only)"), BLUE)
    boxes = [page, console, loop, io, devices, watchdog, relay, recorder, monitor, gnc]
    middle = loop.x + 60
    parts = [
        *map(_box, boxes),
        _arrow([(page.right, 48), (console.x, 48)], both=True),
        _arrow([(console.right, 48), (loop.x, 48)], both=True),
        _text(336, 40, "state", size=11),
        _arrow([(loop.right, 43), (recorder.x, 43)]),
        _text(596, 36, "rows (ring)", size=11),
        _arrow([(loop.right, 109), (monitor.x, 109)]),
        _arrow([(middle, loop.bottom), (middle, io.y)]),
        _text(middle - 8, 160, "setpoints", size=11, anchor="end"),
        _arrow([(middle + 70, io.y), (middle + 70, loop.bottom)]),
        _text(middle + 78, 176, "feedback, poses", size=11),
        _arrow([(middle + 35, io.bottom), (middle + 35, devices.y)], both=True),
        _text(middle + 43, 314, "Modbus, CAN, serial, RS-422", size=11),
        _arrow([(loop.right, 124), (650, 150), (720, watchdog.y)]),
        _text(660, 165, "heartbeat", size=11),
        _arrow([(io.right, 238), (watchdog.x, 238)]),
        _text(600, 230, "heartbeat", size=11),
        _arrow([(785, watchdog.bottom), (785, relay.y)], both=True),
        _text(793, 314, "charge pump, enable", size=11),
        _arrow([(relay.x, 382), (devices.right, 382)]),
        _text(600, 374, "torque", size=11),
        _arrow([(gnc.right, 220), (375, 220), (375, 120), (loop.x, 120)], both=True),
        _text(240, 192, "UDP mailboxes", size=11),
    ]
    return _svg(900, 436, parts)


PATH: Final = (
    ("RS-422", "bytes", "", GREEN),
    ("decode frame", "sync, CRC, exposure", "hil/drivers/vmu/driver.py", ORANGE),
    ("ring", "shared memory", "hil/drivers/remote/io_layout.py", GREY),
    ("camera to chaser", "stage 3", "hil/sensors/mounting.py", BLUE),
    ("filters", "stage 4, at the exposure", "hil/gnc/estimation/fusion.py", BLUE),
    ("guidance, monitor", "stages 5 and 6", "hil/gnc/guidance.py", BLUE),
    ("phase planes", "stage 7", "hil/gnc/control.py", BLUE),
    ("allocation", "thrusters on or off", "hil/gnc/allocation.py", BLUE),
    ("truth", "stages 9 and 10", "hil/dynamics/truth.py", BLUE),
    ("kinematics, limits", "stage 11", "hil/bench/kinematics.py", BLUE),
    ("shared memory", "setpoints", "hil/drivers/remote/devices.py", GREY),
    ("drivers, axes", "the camera moves", "hil/drivers/rails/driver.py", ORANGE),
)
"""Steps of a pose from the wire to the thrusters and back to the wire: title, remark, file, colour."""


def pose_path() -> str:
    """Return the way of one pose from the wire to the thrusters and of its effect to the axes, with file names."""
    width, height, gap, columns = 210, 62, 18, 4
    boxes = []
    for number, (title, remark, file, fill) in enumerate(PATH):
        row, column = divmod(number, columns)
        place = column if row % 2 == 0 else columns - 1 - column  # boustrophedon
        boxes.append(
            Box(
                10 + place * (width + gap),
                10 + row * (height + 30),
                width,
                height,
                tuple(filter(None, (title, remark, file))),
                fill,
            )
        )
    parts = [_box(box) for box in boxes]
    for one, other in pairwise(boxes):
        if one.y == other.y:
            y = one.y + height / 2
            parts.append(_arrow([(one.right, y), (other.x, y)] if other.x > one.x else [(one.x, y), (other.right, y)]))
        else:
            x = one.x + width / 2
            parts.append(_arrow([(x, one.bottom), (x, other.y)]))
    legend = "orange: I/O process; blue: loop; grey: shared memory between them"
    bottom = boxes[-1].bottom
    return _svg(10 + columns * (width + gap), bottom + 30, [*parts, _text(10, bottom + 20, legend, size=12)])


BENCHES: Final = (
    ("A  six axes", "x y z", "roll pitch yaw", ""),
    ("B  rails and one gimbal", "x y z", "yaw", ""),
    ("C  two rails", "x y", "", ""),
    ("D  table of one axis", "", "yaw", ""),
    ("E  plane", "x z", "pitch", ""),
    ("F  target on one axis", "x y z", "roll pitch yaw", "yaw"),
)
"""Benches of a how-to: title, driven rails, driven gimbals of the chaser and of the target."""


def benches() -> str:
    """Return a drawing of each of the benches: target, chaser, and the axes that have a drive."""
    width, height, parts = 290.0, 170.0, []
    for number, (title, rails, gimbals, of_target) in enumerate(BENCHES):
        row, column = divmod(number, 3)
        x, y = 10 + column * width, 10 + row * height
        target = Box(x + 10, y + 66, 76, 44, tuple(filter(None, ("target", of_target))), GREEN)
        chaser = Box(x + 150, y + 66, 104, 44, tuple(filter(None, ("chaser", gimbals))), BLUE)
        middle = chaser.x + chaser.width / 2
        ends = {
            "x": [(target.right + 12, y + 88), (chaser.x - 4, y + 88)],
            "y": [(chaser.right - 8, y + 62), (chaser.right + 16, y + 36)],
            "z": [(middle, chaser.bottom + 4), (middle, chaser.bottom + 36)],
        }
        parts += [_text(x + 10, y + 20, title, size=13, bold=True), _box(target), _box(chaser)]
        for rail in rails.split():
            (_, _), (end, low) = ends[rail]
            parts += [
                _arrow(ends[rail], both=True),
                _text(end + 8 if rail != "x" else end - 36, low - 8, rail, size=12),
            ]
    return _svg(3 * width + 10, 2 * height + 10, parts)


DIAGRAMS: Final[dict[str, Callable[[], str]]] = {
    "layers.svg": layers,
    "processes.svg": processes,
    "pose-path.svg": pose_path,
    "benches.svg": benches,
}


def _svg(width: float, height: float, parts: Sequence[str]) -> str:
    marker = (
        '<marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse">'
        f'<path d="M0 0 8 4 0 8z" fill="{LINE}"/></marker>'
    )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'font-family="Helvetica, Arial, sans-serif">\n<defs>{marker}</defs>\n'
        f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{PAPER}"/>\n'
    )
    return head + "\n".join(parts) + "\n</svg>\n"


def _box(box: Box) -> str:
    rows = [
        f'<rect x="{box.x:g}" y="{box.y:g}" width="{box.width:g}" height="{box.height:g}" rx="5" fill="{box.fill}" '
        f'stroke="{LINE}"/>'
    ]
    first = box.y + box.height / 2 - 9.5 * (len(box.text) - 1) + 5
    for number, text in enumerate(box.text):
        size = 13 if number == 0 else 11
        rows.append(
            _text(box.x + box.width / 2, first + 18 * number, text, size=size, anchor="middle", bold=number == 0)
        )
    return "\n".join(rows)


def _text(x: float, y: float, text: str, *, size: int, anchor: str = "start", bold: bool = False) -> str:
    weight = ' font-weight="600"' if bold else ""
    place = f'x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{anchor}" fill="{INK}"'
    return f"<text {place}{weight}>{escape(text)}</text>"


def _arrow(points: Sequence[tuple[float, float]], *, both: bool = False) -> str:
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    start = ' marker-start="url(#a)"' if both else ""
    return f'<polyline points="{path}" fill="none" stroke="{LINE}" stroke-width="1.4" marker-end="url(#a)"{start}/>'


if __name__ == "__main__":
    for name, draw in DIAGRAMS.items():
        (FOLDER / name).write_text(draw(), encoding="utf-8")
