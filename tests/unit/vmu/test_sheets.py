"""Sheets of targets: what is printed is what the vision unit measures, at full scale and the way that is stated."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hil.cli.main import PASSED, execute
from hil.config.load import load_geometry, load_rig
from hil.vmu.prints import AprilTagSettings
from hil.vmu.sheets import sheet
from tests.support.vmu_pixels import Image
from tests.unit.vmu.test_pose_estimators import geometry

PX_PER_MM = 4.0


def drawn(svg: str) -> tuple[Image, Any]:
    """Return the rectangles of a sheet as an image, and the place of its origin, px."""
    root = ElementTree.fromstring(svg)
    left, top, width, height = (float(number) for number in root.attrib["viewBox"].split())
    assert root.attrib["width"] == f"{width:g}mm"
    image: Image = np.zeros((round(height * PX_PER_MM), round(width * PX_PER_MM)), np.uint8)
    for element in root.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, w, h = (float(element.attrib[name]) for name in ("x", "y", "width", "height"))
        level = 255 if element.attrib["fill"] == "white" else 0
        u, v, u_end, v_end = (round(PX_PER_MM * n) for n in (x - left, y - top, x - left + w, y - top + h))
        image[v:v_end, u:u_end] = level
    return image, -PX_PER_MM * np.array([left, top])


@pytest.mark.parametrize(
    ("estimator", "settings", "way"),
    [
        ("apriltag", {"tags": [[3, 0.06, -0.05, 0.02], [5, 0.04, 0.06, 0.0]]}, "official"),
        ("charuco", {"columns": 5, "rows": 4}, "opencv"),
    ],
)
def test_corners_of_a_printed_sheet_are_where_the_estimator_has_them(
    estimator: str, settings: dict[str, Any], way: str
) -> None:
    from hil.vmu.boards import apriltag, charuco

    vmu = load_rig("mock").value.vmu.model_copy(update={"estimator": estimator, "estimator_settings": settings})
    svg, stated = sheet(vmu)
    assert stated == way
    image, origin = drawn(svg)
    made = {"apriltag": apriltag, "charuco": charuco}[estimator](geometry(way), settings)
    found = made._readers[0](made._detect(image))
    assert len(found) == len(made._points)
    for number, corner in found.items():
        expected = origin - 0.5 + 1e3 * PX_PER_MM * made._points[number, :2]
        np.testing.assert_allclose(corner, expected, atol=1.0)


def test_leds_are_drilled_at_their_places() -> None:
    vmu = load_rig("mock").value.vmu
    svg, way = sheet(vmu)
    assert way is None
    circles = [tuple(map(float, found)) for found in re.findall(r'<circle cx="([^"]+)" cy="([^"]+)"', svg)]
    np.testing.assert_allclose(circles, 1e3 * np.array(vmu.leds_m)[:, :2], atol=1e-3)


def test_command_writes_the_sheet_and_the_key_of_the_geometry_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, made = tmp_path / "tags.svg", tmp_path / "vmu.toml"
    command = [
        "targets",
        "print",
        "--out",
        str(out),
        "--geometry-out",
        str(made),
        "--set",
        "rig.vmu.estimator=apriltag",
    ]
    assert execute(command) == PASSED
    printed = capsys.readouterr().out
    assert f'{out}: its geometry file needs the key print = "official"' in printed
    assert f"{made}: identity not proven" in printed
    assert load_geometry(str(made)).value.print == "official"
    assert AprilTagSettings().family in out.read_text()
