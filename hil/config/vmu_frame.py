"""Frame files: binary or text pose frames of a vision unit (docs/reference/wire-formats.md)."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, Positive

COUNTS: Final = {
    "rate": 3,
    "position": 3,
    "quaternion": 4,
    "euler": 3,
    "covariance": 21,
    "sigma_position": 3,
    "sigma_angle": 3,
}
"""Numbers of a field; one for the others."""
REQUIRED: Final = ("counter", "time", "position")
FieldName = Literal[
    "constant",
    "ignore",
    "counter",
    "time",
    "rate",
    "position",
    "quaternion",
    "euler",
    "covariance",
    "sigma_position",
    "sigma_angle",
    "leds_left",
    "leds_right",
    "status",
]
NumberType = Literal["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64"]
Hexadecimal = Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{2}( ?[0-9A-Fa-f]{2}){0,7}$")]


class FrameField(ConfigModel):
    """One field, of one or more numbers of the same type, in the order of the frame."""

    name: FieldName
    """Meaning: the SI value, m, s or rad, is the number on the wire times `scale`."""
    type: NumberType = "f64"
    """Type of each number; of binary frames, which must give it."""
    scale: Positive = 1.0
    """SI value per unit of the number: 1e-6 for microseconds, 0.001 for millimetres."""
    value: Annotated[int, Field(ge=0)] | None = None
    """Of a `constant`: its value; frames with another one are not decoded."""

    @property
    def count(self) -> int:
        """Return how many numbers the field has."""
        return COUNTS.get(self.name, 1)

    @property
    def inverse(self) -> float | None:
        """The whole number whose inverse is `scale`, None if there is none."""
        whole = float(round(1.0 / self.scale))
        return whole if whole and 1.0 / whole == self.scale else None

    @model_validator(mode="after")
    def _constants_have_values(self) -> Self:
        if (self.name == "constant") != (self.value is not None):
            raise ValueError("value: needed for a constant, and for nothing else")
        is_whole = self.name in ("counter", "leds_left", "leds_right", "status", "constant")
        if is_whole and self.has_type and not self.type.startswith("u"):
            raise ValueError(f'type "{self.type}": of {self.name} allowed are u8, u16, u32, u64')
        return self

    @property
    def has_type(self) -> bool:
        """Whether the file gives the type."""
        return "type" in self.model_fields_set


class FrameChecksum(ConfigModel):
    """Checksum at the end of the frame."""

    kind: Literal["none", "crc16-ccitt-false", "crc16-xmodem", "crc16-modbus", "crc32", "sum8", "xor8"]
    """Algorithm."""
    covers_sync: bool = False
    """Also covers the sync bytes."""
    from_byte: Annotated[int, Field(ge=0)] | None = None
    """First byte of the frame that it covers; unless set, the first one after the sync."""


class FrameStatus(ConfigModel):
    """Meaning of the field `status`. Any other value is a fault of the unit."""

    good: Annotated[int, Field(ge=0)] = 0
    """The frame has a pose."""
    no_pose: Annotated[int, Field(ge=0)] = 1
    """The target is not visible; the other fields are void."""
    position: Annotated[int, Field(ge=0)] | None = None
    """The frame has a position, and no attitude; unless set, the unit has no such frames."""


class TextForm(ConfigModel):
    """Frames as lines of text, a number after the other; in datagrams the end of the line may be missing."""

    start: Annotated[str, Field(pattern=r"^[!-~]*$")] = ""
    """Characters before the first number; lines that begin otherwise are skipped."""
    separator: Annotated[str, Field(pattern=r"^[ -~]$")] = ","
    """Character between numbers; of spaces several count as one."""


class VmuFrame(ConfigModel):
    """Pose frame, with a field `rate` an IMU's: binary of constant length, sync, fields, checksum, or a line of text.

    The pose is that of the target's frame t in the left camera's frame v: ``p_v = R p_t + position``.
    """

    name: str
    """Name of the frame."""
    text: TextForm | None = None
    """Frames of text; unless set, they are binary."""
    byte_order: Literal["little", "big"] = "little"
    """Byte order of all numbers and of the checksum."""
    sync: Hexadecimal | None = None
    """Bytes at the start of binary frames, hexadecimal."""
    identity_sync: Hexadecimal | None = None
    """Bytes at the start of identity frames: vendor and serial number, 16 ASCII characters each, filled up with zeros,
    firmware, major and minor number in a byte each, and the checksum."""
    sync_ends_with_length: bool = False
    """The last byte of a sync is a length: frames with another one are counted."""
    fields: Annotated[tuple[FrameField, ...], Field(min_length=1, max_length=64)]
    """Fields in their order."""
    checksum: FrameChecksum
    """Of text frames `none`, or `xor8` of all before `*` and two hexadecimal digits."""
    rotation: Literal["t_to_v", "v_to_t", "none"]
    """Rotation that quaternion or Euler angles stand for, active, by Hamilton's convention: R, or its inverse; `none`:
    frames of points, which have no attitude."""
    quaternion_order: Literal["xyzw", "wxyz"] = "xyzw"
    """Scalar last or first."""
    euler_sequence: Annotated[str, Field(pattern=r"^([XYZ]{3}|[xyz]{3})$")] = "ZYX"
    """Axes of the Euler angles in their order: upper case about rotated axes, lower case about fixed ones."""
    sigma_position_m: Positive | None = None
    """Standard deviation of the position, per axis, if the frame has none."""
    sigma_angle_deg: Positive | None = None
    """Standard deviation of the attitude, per axis, if the frame has none."""
    status: FrameStatus = FrameStatus()

    @model_validator(mode="after")
    def _form_is_whole(self) -> Self:
        binary = {"sync", "identity_sync", "byte_order", "sync_ends_with_length"} & self.model_fields_set
        typed = [field.name for field in self.fields if field.has_type]
        if self.text is None:
            if self.sync is None or "byte_order" not in binary:
                raise ValueError("sync, byte_order: are missing, or the table text for frames of text")
            if len(typed) < len(self.fields):
                names = ", ".join(field.name for field in self.fields if not field.has_type)
                raise ValueError(f"fields: {names}: type is missing")
        elif binary or typed:
            raise ValueError(f"{', '.join([*sorted(binary), *typed])}: not of frames of text: omit")
        elif self.checksum.kind not in ("none", "xor8"):
            raise ValueError(f'checksum.kind "{self.checksum.kind}": of frames of text allowed are none, xor8')
        return self

    @model_validator(mode="after")
    def _frame_is_a_pose(self) -> Self:
        names = [field.name for field in self.fields]
        repeated = sorted({name for name in names if names.count(name) > 1} - {"constant", "ignore"})
        if repeated:
            raise ValueError(f"fields: {', '.join(repeated)}: more than once")
        if "rate" in names:
            return self._frame_of_an_imu(set(names))
        missing = [name for name in REQUIRED if name not in names]
        if missing:
            raise ValueError(f"fields: {', '.join(missing)}: missing")
        attitudes = [name for name in ("quaternion", "euler") if name in names]
        if len(attitudes) != (self.rotation != "none"):
            text = "a quaternion or euler, one of them" if self.rotation != "none" else 'left out: rotation is "none"'
            raise ValueError(f"fields: the attitude must be {text}")
        if "covariance" in names and {"sigma_position", "sigma_angle"} & set(names):
            raise ValueError("fields: covariance and sigmas are redundant, give one of them")
        for name in ("sigma_position", "sigma_angle"):
            key = f"{name}_{'m' if name == 'sigma_position' else 'deg'}"
            needed = name == "sigma_position" or self.rotation != "none"
            if needed and "covariance" not in names and name not in names and getattr(self, key) is None:
                raise ValueError(f"{key}: is missing: the frame has neither {name} nor covariance")
        if len(set(self.euler_sequence)) == 2 and self.euler_sequence[0] != self.euler_sequence[2]:
            raise ValueError(f"euler_sequence {self.euler_sequence}: neighbouring axes must differ")
        if len(set(self.euler_sequence)) == 1:
            raise ValueError(f"euler_sequence {self.euler_sequence}: neighbouring axes must differ")
        return self

    def _frame_of_an_imu(self, names: set[str]) -> Self:
        needed, other = {"counter", "time", "rate"}, {"status", "constant", "ignore"}
        if missing := sorted(needed - names):
            raise ValueError(f"fields: {', '.join(missing)}: missing")
        if wrong := sorted(names - needed - other):
            raise ValueError(f"fields: {', '.join(wrong)}: not of an IMU's frame, which has rate")
        if self.rotation != "none":
            raise ValueError(f'rotation "{self.rotation}": an IMU\'s frame has no pose, allowed "none"')
        return self

    def warnings(self) -> list[str]:
        """Return one line per protection that these frames lack."""
        warnings = []
        if self.checksum.kind == "none":
            warnings.append(f"frame {self.name}: no checksum: a corrupted pose can be accepted")
        if "status" not in [field.name for field in self.fields]:
            warnings.append(f"frame {self.name}: no status: the unit cannot report that it has no pose")
        return warnings
