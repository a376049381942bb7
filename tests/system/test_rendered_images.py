"""Images of a run in its recording, and through vision unit and docking monitor once more."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from hil.cli.main import INCOMPLETE, execute
from hil.config.load import load_rig, load_scene
from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import GEOMETRY_FILE, SCENE_FILE
from hil.parts.vision.replay_images import replay_monitor, replay_vision_unit
from hil.recording.images import pairs, recorded_images
from hil.recording.read import Recorded, load
from hil.recording.replay import replay
from hil.vmu.geometry import geometry_of_rig
from tests.support.run_settings import typed

pytestmark = pytest.mark.xdist_group("vision unit")

RENDERED = ("vmu.source=rendered", "monitor.source=rendered", "initial.position_m=[2.0, -0.05, 0.05]")
ALL_PNG = ("rig.recording.images=png", "rig.recording.image_interval_s=0")


def record(folder: Path, duration_s: float, *settings: str, rig: str = "mock") -> Path:
    """Return the recording of a short run of scheme-1."""
    options = ["--rig", rig, "--duration", f"{duration_s:g}", "--record", str(folder), "--json", f"{folder}.json"]
    assert execute(["run", "scheme-1", *typed(*settings), *options]) in (0, 1)
    (path,) = folder.glob("*.mcap")
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 2 s whose images were all kept as PNG; do not change it."""
    return record(tmp_path_factory.mktemp("pictures") / "png", 2.0, *RENDERED, *ALL_PNG)


@pytest.fixture(scope="module")
def recorded(path: Path) -> Recorded:
    return load(path)


def geometry_of(recorded: Recorded) -> VmuGeometry:
    return recorded.calibration(GEOMETRY_FILE, VmuGeometry)


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one line that the command printed."""
    capsys.readouterr()
    assert execute(list(arguments)) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_images_and_findings_are_in_the_recording(path: Path) -> None:
    with path.open("rb") as file:
        reader = make_reader(file)
        counts = {channel.topic: 0 for channel in reader.get_summary().channels.values()}  # type: ignore[union-attr]
        for schema, channel, message in reader.iter_messages(topics=[t for t in counts if t.startswith("/pictures/")]):
            counts[channel.topic] += 1
            told = json.loads(message.data)
            assert schema is not None
            if channel.topic.endswith("/annotations"):
                assert schema.name == "foxglove.ImageAnnotations"
                assert told["texts"]
            else:
                assert schema.name == "foxglove.CompressedImage"
                assert (told["format"], told["left_out"]) == ("png", 0)
    for camera, count in (("vmu.left", 13), ("vmu.right", 13), ("monitor", 26)):
        assert (counts[f"/pictures/{camera}"], counts[f"/pictures/{camera}/annotations"]) == (count, count)
    left = [picture for picture, _ in pairs(path)]
    assert [picture.number for picture in left] == list(range(13))
    assert [picture.bench_s for picture in left] == [k / 6.25 for k in range(13)]
    assert [picture.t_s for picture in left] == [k / 6.25 for k in range(13)]  # bench and run begin together here
    assert left[0].image(path).shape == (1024, 1024)
    assert {picture.status for picture in recorded_images(path, "monitor")} == {"near"}


def test_same_images_give_the_very_same_poses(recorded: Recorded) -> None:
    found = replay_vision_unit(recorded, geometry_of(recorded))
    assert found.identical, (found.statuses, found.differences)
    assert (found.images, found.compared, found.remarks) == (13, 13, [])


def test_the_same_frames_give_the_very_same_portions(recorded: Recorded) -> None:
    found = replay_monitor(recorded, recorded.calibration(SCENE_FILE, Scene))
    assert found.identical, (found.statuses, found.differences)
    assert (found.images, found.compared, len(recorded.of_parts["portions"])) == (
        26,
        len(recorded.of_parts["portions"]),
        3,
    )


def test_gnc_of_a_run_on_images_replays_bit_by_bit(recorded: Recorded) -> None:
    assert replay(recorded, recorded.scenario).identical


def test_command_reports_that_all_is_the_same(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["replay", str(path), "--vmu", "--monitor"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [
        "identical, bit by bit: the vision unit, 13 exposures, 13 poses",
        "identical, bit by bit: the docking monitor, 26 exposures, 3 portions",
    ]


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A run of cameras that their geometry and scene files state, with these files."""
    folder = tmp_path_factory.mktemp("identified")
    identity = {"serial": "17", "offset_px": [512, 512], "binning": [1, 1], "reversed": [False, False]}
    known = geometry_of_rig(load_rig("mock").value).model_dump(mode="json", exclude_none=True)
    known["left"]["identity"], known["right"]["identity"] = identity, identity | {"serial": "18"}
    geometry, scene = folder / "vmu.json", folder / "scene.json"
    geometry.write_text(json.dumps(known))
    scene.write_text(json.dumps({"extends": "atv", "camera": {"identity": identity}}))
    files = f'rig.vmu.geometry_file="{geometry}"', f'monitor.scene="{scene}"'
    return record(folder / "run", 1.0, *RENDERED, *ALL_PNG, *files), geometry, scene


@pytest.mark.parametrize(
    ("key", "value"),
    [("serial", "19"), ("offset_px", [528, 512]), ("binning", [2, 2]), ("reversed", [True, False])],
)
def test_recording_of_another_camera_is_refused(
    identified: tuple[Path, Path, Path], key: str, value: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, geometry, scene = identified
    other = json.loads(geometry.read_text())
    other["right"]["identity"][key] = value
    (tmp_path / "vmu.json").write_text(json.dumps(other))
    line = refused(capsys, "replay", str(path), "--vmu", "--geometry", str(tmp_path / "vmu.json"))
    assert f"vmu.json: right.identity.{key}: {json.dumps(value)}: the recording has " in line
    other = json.loads(scene.read_text())
    other["camera"]["identity"][key] = value
    (tmp_path / "scene.json").write_text(json.dumps(other))
    line = refused(capsys, "replay", str(path), "--monitor", "--scene", str(tmp_path / "scene.json"))
    assert f"scene.json: monitor.identity.{key}: {json.dumps(value)}: the recording has " in line


def test_replay_states_whether_the_identity_is_proven(
    identified: tuple[Path, Path, Path], path: Path, tmp_path: Path
) -> None:
    _, geometry, scene = identified
    words = ["--vmu", "--geometry", str(geometry), "--monitor", "--scene", str(scene), "--json", str(tmp_path / "out")]
    for recording, verdict in (
        (identified[0], "proven"),
        (path, "identity not proven: no serial and offset_px in images"),
    ):
        execute(["replay", str(recording), *words])
        found = json.loads((tmp_path / "out").read_text())
        assert (found["vmu"]["identity"], found["monitor"]["identity"]) == (verdict, verdict)


def test_another_geometry_moves_the_poses_by_what_it_is_off(recorded: Recorded, tmp_path: Path) -> None:
    believed = geometry_of(recorded).model_dump(mode="json")
    for side in ("left", "right"):
        believed[side]["cx"] += 2.0
    other, out = tmp_path / "other.json", tmp_path / "out.json"
    other.write_text(json.dumps(believed))
    assert execute(["replay", str(recorded.path), "--vmu", "--geometry", str(other), "--json", str(out)]) == 0
    found = json.loads(out.read_text())["vmu"]
    assert (found["changed"], found["identical"], found["compared"]) == (True, False, 13)
    assert found["statuses"] == [{"recorded": "ok", "replayed": "ok", "count": 13}]
    (x,) = [d for d in found["differences"] if d["name"] == "x"]
    range_m = recorded.arrivals["frame"]["t_v"][:, 2].max()
    assert x["largest"] == pytest.approx(2.0 / 1200.0 * range_m, rel=0.1)
    assert (x["count"], x["first_s"]) == (13, 0.0)
    assert x["largest_sigmas"] > 1.0


def test_another_scene_shows_in_range_and_sigmas(
    recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = json.loads(recorded.files[SCENE_FILE])
    other["camera"]["f"] *= 1.01
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(other))
    assert execute(["replay", str(recorded.path), "--monitor", "--scene", str(path)]) == 0
    said = capsys.readouterr().out
    assert next(line.split()[:2] for line in said.splitlines() if line.startswith("range ")) == ["range", "mm"]
    assert said.splitlines()[-1].startswith("differs from 0.")


def test_exported_images_give_hil_vmu_the_same_poses(recorded: Recorded, tmp_path: Path) -> None:
    folder, out = tmp_path / "pictures", tmp_path / "poses.csv"
    assert execute(["export", str(recorded.path), "--images", str(folder)]) == 0
    geometry = str(folder / GEOMETRY_FILE)
    assert execute(["vmu", str(folder), "--geometry", geometry, "--rate-hz", "6.25", "--out", str(out)]) == 0
    with out.open() as file:
        poses = list(csv.DictReader(file))
    found = np.array([[float(pose[name]) for name in ("t_s", "x_m", "y_m", "z_m")] for pose in poses])
    frames = recorded.arrivals["frame"]
    np.testing.assert_allclose(found, np.column_stack((frames["t_s"], frames["t_v"])), rtol=1e-8)
    with (folder / "times.csv").open() as file:
        times = list(csv.DictReader(file))
    assert len(times) == 13 + 13 + 26
    assert [float(row["t_s"]) for row in times if row["camera"] == "vmu.left"] == frames["t_s"].tolist()


def test_exported_frames_give_hil_monitor_the_same_portions(recorded: Recorded, tmp_path: Path) -> None:
    folder, out = tmp_path / "pictures", tmp_path / "monitor.csv"
    assert execute(["export", str(recorded.path), "--images", str(folder)]) == 0
    arguments = ["monitor", str(folder / "monitor"), "--scene", str(folder / SCENE_FILE), "--out", str(out)]
    assert execute(arguments) == 0
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["t_s"]) for row in rows] == pytest.approx(recorded.of_parts["portions"]["t_s"])
    # the command's default of what motion may do differs from that of the run's guidance
    assert [float(row["range_m"]) for row in rows] == pytest.approx(recorded.of_parts["portions"]["range_m"], abs=1e-3)


def test_portions_are_exported_together_with_the_cycles(recorded: Recorded, tmp_path: Path) -> None:
    assert execute(["export", str(recorded.path), "--out", str(tmp_path / "run.csv")]) == 0
    with (tmp_path / "run-portions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["near"] * 3
    assert [float(row["range_m"]) for row in rows] == recorded.of_parts["portions"]["range_m"].tolist()


def test_half_frames_are_interleaved_into_images_again(tmp_path: Path) -> None:
    path = record(tmp_path / "run", 0.2, "monitor.source=rendered", "monitor.scene=bright-cross", *ALL_PNG)
    recorded = load(path)
    found = replay_monitor(recorded, recorded.calibration(SCENE_FILE, Scene))
    assert found.identical
    scene = load_scene("bright-cross").value
    half_frames = list(recorded_images(path, "monitor"))
    assert [picture.number for picture in half_frames] == list(range(len(half_frames)))
    folder = tmp_path / "pictures"
    assert execute(["export", str(path), "--images", str(folder)]) == 0
    files = sorted((folder / "monitor").glob("*.png"))
    assert len(files) == -(-len(half_frames) // 2)
    image = cv2.imread(str(files[1]), cv2.IMREAD_GRAYSCALE)
    first = 0 if scene.fields == "upper_first" else 1
    np.testing.assert_array_equal(image[first::2], half_frames[2].image(path)[::2])
    np.testing.assert_array_equal(image[1 - first :: 2], half_frames[3].image(path)[::2])


def test_occasional_jpeg_replays_with_a_remark(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path / "run", 2.0, *RENDERED[::2])  # as the rig file has it
    assert [picture.bench_s for picture, _ in pairs(path)] == [k / 6.25 for k in (0, 4, 8, 12)]
    assert math.isclose(path.stat().st_size, 8 * 45_000, rel_tol=0.9)
    capsys.readouterr()
    assert execute(["replay", str(path), "--vmu"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "the images are JPEG, not the original ones: differences are expected"
    assert said[1] == "9 of 13 exposures are not recorded: differences are expected"
    assert said[-1].startswith("differs from 0.00 s on: the vision unit, 4 exposures")


def test_no_images_are_kept_if_none_are_requested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path / "run", 0.4, "vmu.source=rendered", "rig.recording.images=none")
    line = refused(capsys, "replay", str(path), "--vmu")
    assert "has no images of the vision unit" in line
    assert "recording.images" in line


def test_recording_without_images_is_one_line(recorded_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, said in (
        (["replay", str(recorded_run), "--vmu"], "holds no images of the vision unit"),
        (["replay", str(recorded_run), "--monitor"], "holds no images of a docking monitor"),
        (["export", str(recorded_run), "--images", f"{recorded_run}.pictures"], "has no images"),
    ):
        assert said in refused(capsys, *arguments)
    assert not Path(f"{recorded_run}.pictures").exists()


def test_truncated_recording_gives_its_complete_images(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 4])
    capsys.readouterr()
    assert execute(["replay", str(cut), "--vmu"]) == INCOMPLETE
    assert f"{cut}: cut: it has no end" in caplog.text
    (last,) = capsys.readouterr().out.splitlines()
    assert last.startswith("identical, bit by bit: the vision unit, ")
    cut.write_bytes(whole[:30_000])
    assert "has no images" in refused(capsys, "replay", str(cut), "--vmu")
    cut.write_bytes(b"no recording")
    assert "not a recording" in refused(capsys, "export", str(cut), "--images", str(tmp_path / "out"))


def test_options_that_do_not_go_together_are_named(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "left").mkdir()
    for arguments, said in (
        (["replay", str(path), "--geometry", "g.toml"], "--geometry: goes with --vmu"),
        (["replay", str(path), "--scene", "atv"], "--scene: goes with --monitor"),
        (["replay", str(path), "--vmu", "--set", "gnc.control.lead_s=1.0"], "--set: goes with a replay of the GNC"),
        (["replay", str(path), "--vmu", "--geometry", "g.toml"], "g.toml"),
        (["export", str(path), "--images", str(tmp_path), "--out", "x.csv"], "--out: goes with the numbers"),
        (["export", str(path), "--images", str(tmp_path)], "exists"),
    ):
        assert said in refused(capsys, *arguments)


def test_a_wrong_setting_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "run", "scheme-1", "--set", "rig.recording.images=bmp")
    assert "recording.images" in line
    assert "jpeg" in line
