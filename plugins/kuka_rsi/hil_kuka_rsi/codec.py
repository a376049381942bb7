"""Telegrams of RSI: XML <-> numbers. No I/O, no clock. Lengths in mm, angles in degrees, as on the wire.

A frame is X, Y, Z and A, B, C: rotations about z, then y, then x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal
from xml.etree import ElementTree

import numpy as np

from hil.core.messages import Array

CARTESIAN: Final = ("X", "Y", "Z", "A", "B", "C")
JOINTS: Final = ("A1", "A2", "A3", "A4", "A5", "A6")
RUNNING, STOPPED, SAFETY_STOP = 1, 2, 4
"""Element Stat of the telegram that the generated files define: correction active; ended; safety stop."""
_MM: Final = 1000.0
Rotation = Literal["frame", "angles"]
"""A, B, C of a correction: a rotation about the axes of the base, or added to those of the pose."""


@dataclass(frozen=True)
class RobotState:
    """What the controller sends: actual and commanded frame, joints, correction so far, counts and state.

    corrected, joints, status: None if its configuration does not send them. delayed: late answers so far.
    """

    ipoc: int
    actual: Array
    commanded: Array
    joints: Array | None = None
    corrected: Array | None = None
    delayed: int = 0
    status: int | None = None


def encode_state(state: RobotState) -> bytes:
    """Return the telegram of the controller."""
    root = ElementTree.Element("Rob", Type="KUKA")
    for tag, keys, values in (
        ("RIst", CARTESIAN, state.actual),
        ("RSol", CARTESIAN, state.commanded),
        ("AIPos", JOINTS, state.joints),
        ("PosCorrMon", CARTESIAN, state.corrected),
    ):
        if values is not None:
            ElementTree.SubElement(root, tag, _attributes(keys, values))
    ElementTree.SubElement(root, "Delay", D=str(state.delayed))
    if state.status is not None:
        ElementTree.SubElement(root, "Stat").text = str(state.status)
    ElementTree.SubElement(root, "IPOC").text = str(state.ipoc)
    return ElementTree.tostring(root)


def decode_state(data: bytes) -> RobotState:
    """Return what a telegram of the controller says. Raises ValueError."""
    root = _parsed(data, "Rob")
    actual = _numbers(root, "RIst", CARTESIAN)
    if actual is None:
        raise ValueError("no RIst")
    commanded, delay = _numbers(root, "RSol", CARTESIAN), root.find("Delay")
    return RobotState(
        _integer(root, "IPOC"),
        actual,
        actual if commanded is None else commanded,
        _numbers(root, "AIPos", JOINTS),
        _numbers(root, "PosCorrMon", CARTESIAN),
        0 if delay is None else int(delay.get("D", "")),
        None if root.find("Stat") is None else _integer(root, "Stat"),
    )


def encode_answer(ipoc: int, correction: Array, sen_type: str) -> bytes:
    """Return the answer to the telegram ``ipoc``. correction: (6,), of the frame."""
    root = ElementTree.Element("Sen", Type=sen_type)
    ElementTree.SubElement(root, "RKorr", _attributes(CARTESIAN, correction))
    ElementTree.SubElement(root, "IPOC").text = str(ipoc)
    return ElementTree.tostring(root)


def decode_answer(data: bytes, sen_type: str) -> tuple[int, Array]:
    """Return IPOC and correction (6,) of an answer. Raises ValueError, also for another type of sender."""
    root = _parsed(data, "Sen")
    if root.get("Type") != sen_type:
        raise ValueError(f"Type {root.get('Type')!r}, expected {sen_type!r}")
    correction = _numbers(root, "RKorr", CARTESIAN)
    if correction is None:
        raise ValueError("no RKorr")
    return _integer(root, "IPOC"), correction


def frame_of(position_m: Array, axes: Array) -> Array:
    """Return the frame (6,) of a position, m, and of axes that are the columns of ``axes`` (3, 3)."""
    b = math.atan2(-axes[2, 0], math.hypot(axes[0, 0], axes[1, 0]))
    if math.cos(b) > 1e-9:
        a, c = math.atan2(axes[1, 0], axes[0, 0]), math.atan2(axes[2, 1], axes[2, 2])
    else:
        a, c = math.atan2(-axes[0, 1], axes[1, 1]), 0.0
    return np.array([*(_MM * position_m).tolist(), *np.degrees([a, b, c]).tolist()])


def pose_of(frame: Array) -> tuple[Array, Array]:
    """Return position (3,), m, and axes (3, 3) of a frame (6,)."""
    (sa, ca), (sb, cb), (sc, cc) = ((math.sin(angle), math.cos(angle)) for angle in np.radians(frame[3:]).tolist())
    axes = np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    )
    return frame[:3] / _MM, axes


def correction_between(start: Array, goal: Array, rotation: Rotation) -> Array:
    """Return the correction (6,) that takes the frame ``start`` to ``goal``."""
    if rotation == "angles":
        return _wrapped(goal - start)
    (r, axes), (r_goal, axes_goal) = pose_of(start), pose_of(goal)
    return frame_of(r_goal - r, axes_goal @ axes.T)


def corrected(start: Array, correction: Array, rotation: Rotation) -> Array:
    """Return the frame (6,) to which ``correction`` takes ``start``."""
    if rotation == "angles":
        return start + correction
    (r, axes), (shift, turn) = pose_of(start), pose_of(correction)
    return frame_of(r + shift, turn @ axes)


def uncorrected(goal: Array, correction: Array, rotation: Rotation) -> Array:
    """Return the frame (6,) that ``correction`` takes to ``goal``."""
    if rotation == "angles":
        return goal - correction
    (r, axes), (shift, turn) = pose_of(goal), pose_of(correction)
    return frame_of(r - shift, turn.T @ axes)


def _wrapped(frame: Array) -> Array:
    """Return a frame (6,) with its angles within half a turn."""
    return np.concatenate([frame[:3], (frame[3:] + 180.0) % 360.0 - 180.0])


def _parsed(data: bytes, tag: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ValueError(f"not XML: {error}") from error
    if root.tag != tag:
        raise ValueError(f"element {root.tag}, expected {tag}")
    return root


def _attributes(keys: tuple[str, ...], values: Array) -> dict[str, str]:
    return {key: f"{value:.6f}" for key, value in zip(keys, values.tolist(), strict=True)}


def _numbers(root: ElementTree.Element, tag: str, keys: tuple[str, ...]) -> Array | None:
    element = root.find(tag)
    if element is None:
        return None
    values = np.array([float(element.get(key, "")) for key in keys])
    if not np.isfinite(values).all():
        raise ValueError(f"{tag} is not finite")
    return values


def _integer(root: ElementTree.Element, tag: str) -> int:
    return int(root.findtext(tag, ""))
