"""Layout of the records: what is recorded, sent and compiled into kernels keeps its place."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from docs import record_pages
from docs.record_pages import markdown_table
from hil.core import gnc_records, messages
from hil.core.fields import Field, Fields, leaf_fields, record_dtype
from hil.core.messages import VMU_FRAME, PoseFrame
from hil.parts.monitor import results

ROOT = Path(__file__).resolve().parents[3]

LAYOUTS = {
    "AXES": (96, "864c723aaef4"),
    "COMMAND": (392, "90f73bd811ca"),
    "CYCLE": (2344, "4bb87269efe4"),
    "IMU": (96, "958bd7519946"),
    "NAVIGATION": (240, "eb659804b67c"),
    "POSE": (296, "b04be1be7562"),
    "REFERENCE": (168, "52b17d7a37e9"),
    "SUPERVISION": (120, "b18b0cab327d"),
    "TRUTH": (680, "56851cd7ba47"),
    "GNC_INPUT": (11288, "4ec80ab0dc49"),
    "GNC_OUTPUT": (280, "a91511b65061"),
    "GNC_POSE": (208, "6c6d24011bad"),
    "GNC_ORBIT": (120, "9bc70198134b"),
    "GNC_SETUP": (1560, "ad6e99fff6cd"),
    "ARRIVAL": (696, "c7af71a6f68b"),
    "VMU_FRAME": (392, "721886daa9d1"),
}


def layout(dtype: np.dtype) -> tuple[int, str]:
    return dtype.itemsize, hashlib.sha256(str(dtype.descr).encode()).hexdigest()[:12]


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout_of_a_record_stays(name: str) -> None:
    module = gnc_records if name.startswith("GNC") else messages
    dtype = getattr(module, name)
    assert layout(dtype) == LAYOUTS[name]
    assert dtype == record_dtype(getattr(module, f"{name}_FIELDS"))
    assert dtype.isalignedstruct


def test_input_of_protocol_3_is_the_first_part_of_the_present_one() -> None:
    """Programs that were compiled for it read and write these bytes."""
    assert layout(gnc_records.GNC_INPUT_3) == (1024, "50ffc677be9d")


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_field_has_a_meaning_and_a_unit(name: str) -> None:
    fields = getattr(gnc_records if name.startswith("GNC") else messages, f"{name}_FIELDS")
    assert all(field.meaning and (field.unit or str(field.type).startswith("S")) for field in leaf_fields(fields))


@pytest.mark.parametrize("name", [name for name in LAYOUTS if not name.startswith("GNC")] + ["PORTION"])
def test_page_shows_the_layout_of_a_record(name: str) -> None:
    table = markdown_table(getattr(results if name == "PORTION" else messages, f"{name}_FIELDS"))
    assert table in record_pages.records()


@pytest.mark.parametrize("fields", [messages.GIMBALS_FIELDS, messages.MANIPULATOR_SAMPLE_FIELDS])
def test_page_shows_the_layout_of_the_axes_of_a_rotated_target(fields: Fields) -> None:
    assert markdown_table(fields) in record_pages.records()
    assert layout(messages.MANIPULATOR_SAMPLE) == (304, "2e37f8e27cd8")


def test_page_shows_the_layout_of_axes_that_are_held() -> None:
    assert markdown_table(messages.HELD_SAMPLE_FIELDS) in record_pages.records()
    assert layout(messages.HELD_SAMPLE) == (168, "77c100417314")


def test_nested_records_are_expanded_with_dotted_names() -> None:
    inner = (Field("a", "i4"), Field("b", "f8", 2, "m", "c", "place"))
    outer = (Field("n", "i8"), Field("inner", inner))
    assert [field.name for field in leaf_fields(outer)] == ["n", "inner.a", "inner.b"]
    assert record_dtype(outer)["inner"].fields["b"][1] == 8  # type: ignore[index]  # aligned as in C
    assert markdown_table(outer).splitlines()[2:] == [
        "| 0 | i8 | `n` |  |  |  |",
        "| 8 | record | `inner` |  |  |  |",
        "| 32 | | | | | *size* |",
    ]


def test_a_pose_frame_survives_its_record() -> None:
    rng = np.random.default_rng(5)
    frame = PoseFrame(7, 1.5, 1.6, rng.normal(size=3), rng.normal(size=4), rng.normal(size=(6, 6)), 3, 5, 2)
    record = np.zeros(1, VMU_FRAME)
    frame.write_to(record)
    back = PoseFrame.from_record(record[0])
    record[:] = np.zeros(1, VMU_FRAME)
    for name in VMU_FRAME.names or ():
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    assert type(back.counter) is int
