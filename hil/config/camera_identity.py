"""Identity of a camera: which one it is, its lens, and which part of its sensor its images show.

Geometry and scene files state it as measured by their calibration, a folder of images in CAMERAS_FILE, and an open
camera reports its own. What only one of both states is not compared.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, ValidationError

from hil.config.tables.model import ConfigModel
from hil.core.files import MIB, read_bytes, write_text
from hil.errors import BadInput

CAMERAS_FILE: Final = "cameras.json"
"""Identities of the cameras of a folder of images, by ``left`` and ``right``, or ``monitor``."""
MONITOR_CAMERA: Final = "monitor"
PROVEN: Final = "proven"
NOT_PROVEN: Final = "identity not proven"
Pixels = tuple[Annotated[int, Field(ge=0, le=65536)], Annotated[int, Field(ge=0, le=65536)]]


class CameraIdentity(ConfigModel):
    """A camera with its lens and the part of its sensor that its images show."""

    model: str | None = None
    """Vendor and model."""
    serial: str | None = None
    """Serial number."""
    firmware: str | None = None
    """Version of its firmware."""
    lens: str | None = None
    """Lens, focus and aperture, as the laboratory writes them: no camera reports them."""
    sensor_px: Pixels | None = None
    """Width and height of the sensor."""
    offset_px: Pixels | None = None
    """Corner of the images on the sensor."""
    binning: Pixels | None = None
    """Sensor pixels per image pixel, along u and v."""
    reversed: tuple[bool, bool] | None = None
    """Whether the camera mirrors its images along u and v."""
    date: str | None = None
    """Day on which this was read; not compared."""

    def difference(self, actual: CameraIdentity) -> tuple[str, str, str] | None:
        """Return the first key in which ``actual`` differs, its value here and there, as texts; None without one."""
        for key in type(self).model_fields:
            here, there = getattr(self, key), getattr(actual, key)
            if key != "date" and None not in (here, there) and here != there:
                return key, json.dumps(here), json.dumps(there)
        return None

    @property
    def is_complete(self) -> bool:
        """Whether it states one camera and one region of its sensor."""
        return self.serial is not None and self.offset_px is not None


UNKNOWN: Final = CameraIdentity()


def identity_problem(
    stated: Mapping[str, CameraIdentity | None], actual: Mapping[str, CameraIdentity | None]
) -> tuple[str, str, str, str] | None:
    """Return camera, key, stated and actual value of the first difference of two sets of cameras, None without one."""
    for name, identity in stated.items():
        other = (identity or UNKNOWN).difference(actual.get(name) or UNKNOWN)
        if other is not None:
            return name, *other
    return None


def identity_doubt(stated: Mapping[str, CameraIdentity | None], actual: Mapping[str, CameraIdentity | None]) -> str:
    """Return "" if the cameras are proven to be the stated ones, else that they are not, and what is missing."""
    texts = []
    for where, side in (("file", stated), ("images", actual)):
        names = [name for name in stated if not (side.get(name) or UNKNOWN).is_complete]
        if names:
            texts.append(where if len(names) == len(stated) else f"{where} ({', '.join(names)})")
    return f"{NOT_PROVEN}: no serial and offset_px in {', '.join(texts)}" if texts else ""


def file_doubt(stated: Mapping[str, CameraIdentity | None], path: str) -> str:
    """Return "" if the file ``path``, just written, states its cameras, else that it does not, and what does."""
    if all(each is not None and each.is_complete for each in stated.values()):
        return ""
    return f"{path}: {NOT_PROVEN}, no serial and offset_px: hil calibrate writes those of hil cameras identity"


def check_folder(stated: Mapping[str, CameraIdentity | None], folder: Path, source: str) -> str:
    """Return ``check_same`` of the images in ``folder``, or of a video."""
    return check_same(stated, read_identities(folder), source, f"the images of {folder} have")


def check_same(
    stated: Mapping[str, CameraIdentity | None], actual: Mapping[str, CameraIdentity | None], source: str, what: str
) -> str:
    """Return ``identity_doubt``; raise BadInput if ``actual`` are other cameras than the file ``source`` has.

    what: of the error, "the recording has".
    """
    if problem := identity_problem(stated, actual):
        name, key, here, there = problem
        raise BadInput.single(source, f"{name}.identity.{key}", f"{here}: {what} {there}")
    return identity_doubt(stated, actual)


def read_identities(folder: Path) -> dict[str, CameraIdentity | None]:
    """Return the identities in CAMERAS_FILE of ``folder``, or in that of a file, none without one. Raises BadInput."""
    path = (folder.parent if folder.is_file() else folder) / CAMERAS_FILE
    if not path.is_file():
        return {}
    try:
        table = json.loads(read_bytes(path, MIB))
        return {name: CameraIdentity.model_validate(each, strict=False) for name, each in table.items()}
    except (ValueError, AttributeError, ValidationError) as error:
        raise BadInput.single(
            str(path), "", f"not identities of cameras: {' '.join(str(error).split())[:120]}"
        ) from error


def write_identities(identities: Mapping[str, CameraIdentity | None], folder: Path) -> None:
    """Write CAMERAS_FILE into ``folder``, which exists; nothing if no identity is known."""
    table = {name: each.model_dump(exclude_none=True) for name, each in identities.items() if each is not None}
    if table:
        write_text(json.dumps(table, indent=2) + "\n", str(folder / CAMERAS_FILE))


def identity_by(read: Callable[[str, type], Any]) -> CameraIdentity:
    """Return the identity that a camera reports by its features (SFNC); one without a feature neither bins nor mirrors.

    read: returns the value of a feature as this type, None without such a feature.
    """

    def first(kind: type, *names: str) -> Any:
        return next((value for name in names if (value := read(name, kind)) not in (None, "")), None)

    def pair(kind: type, *names: tuple[str, ...], default: Any = None) -> Any:
        values = tuple(default if (value := first(kind, *each)) is None else value for each in names)
        return None if None in values else values

    words = [word for name in ("DeviceVendorName", "DeviceModelName") if (word := first(str, name))]
    return CameraIdentity(
        model=" ".join(words) or None,
        serial=first(str, "DeviceSerialNumber", "DeviceID"),
        firmware=first(str, "DeviceFirmwareVersion", "DeviceVersion"),
        sensor_px=pair(int, ("SensorWidth", "WidthMax"), ("SensorHeight", "HeightMax")),
        offset_px=pair(int, ("OffsetX",), ("OffsetY",)),
        binning=pair(int, ("BinningHorizontal",), ("BinningVertical",), default=1),
        reversed=pair(bool, ("ReverseX",), ("ReverseY",), default=False),
    )
