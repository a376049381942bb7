"""Bag of ROS 2 from a recording: its messages have the numbers of the recording."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from hil.cli.main import execute
from hil.parts.export.ros2 import TOPICS, definition, export_ros2, in_hill, start_ns
from hil.recording.read import Recorded, load
from hil.report.page import report
from tests.support.run_settings import typed

pytestmark = pytest.mark.xdist_group("campaign")

SECONDS = 4


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("runs")
    settings = typed("imu.gyro_drift_initial_sigma_degps=0.001")
    assert execute(["run", "scheme-1", "--duration", str(SECONDS), "--record", str(folder), *settings]) in (0, 1)
    (path,) = folder.glob("**/*.mcap")
    return load(path)


@pytest.fixture(scope="module")
def bag(recorded: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bags") / "bag"
    assert execute(["export", str(recorded.path), "--format", "ros2", "-o", str(out)]) == 0
    return out


def test_bag_has_every_topic_and_its_metadata_counts_them(recorded: Recorded, bag: Path) -> None:
    found = json.loads((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in found["topics_with_message_count"]}
    with (bag / found["relative_file_paths"][0]).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == found["message_count"] == sum(counts.values())
    assert {schema.name for schema in summary.schemas.values()} == {TOPICS[topic] for topic in counts}
    assert counts["/truth/pose"] == counts["/imu"] == counts["/tf"] == len(recorded.cycles)
    assert counts["/vision/pose"] == int((recorded.cycles["pose"]["fresh"] > 0).sum())
    assert found["starting_time"]["nanoseconds_since_epoch"] == start_ns(recorded)


def test_further_sensors_have_topics_and_a_row_in_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = typed("sensors.ranger.kind=range_finder", "sensors.stars.kind=star_tracker")
    assert execute(["run", "scheme-1", "--duration", "2", "--record", str(tmp_path / "runs"), *settings]) in (0, 1)
    (path,) = (tmp_path / "runs").glob("**/*.mcap")
    counts = export_ros2(path, tmp_path / "bag")
    samples = load(path).sensor_arrivals["sample"]
    for number, name in enumerate(("ranger", "stars")):
        assert counts[f"/sensors/{name}"] == (samples["sensor"] == number).sum() > 4
    with next((tmp_path / "bag").glob("*.mcap")).open("rb") as file:
        data = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/sensors/ranger"])]
    for message, sample in zip(data, samples[samples["sensor"] == 0], strict=True):
        assert np.float64(sample["value"][0]).tobytes() in message
        assert np.sqrt(sample["covariance"][0, 0]).tobytes() in message
        assert b"range_m" in message
    monkeypatch.setattr("hil.report.page.figures", lambda *_: ())
    assert ">ranger</td>" in report([load(path)])


def test_whole_cycle_is_the_record_behind_the_encapsulation(recorded: Recorded, bag: Path) -> None:
    with next(bag.glob("*.mcap")).open("rb") as file:
        data = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/cycle"])]
    assert [each[4:] for each in data] == [row.tobytes() for row in recorded.cycles]
    fields = [
        line.split()[1] for part in definition(TOPICS["/cycle"]).split("=" * 80) for line in part.splitlines()[1:]
    ]
    assert all(re.fullmatch(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*|hil_msgs/\w+", name) for name in fields)
    assert len(fields) > 60


def test_truth_is_at_its_place_in_the_message(recorded: Recorded, bag: Path) -> None:
    """Header (stamp, "H"), padding to 8, seven float64 behind the four bytes of the encapsulation."""
    with next(bag.glob("*.mcap")).open("rb") as file:
        messages = [m for _, _, m in make_reader(file).iter_messages(topics=["/truth/pose"])]
    for message, row in zip(messages, recorded.cycles, strict=True):
        assert message.data[:4] == b"\0\1\0\0"
        values = np.frombuffer(message.data, "<f8", 7, 4 + 16)
        assert values[:3].tobytes() == row["truth"]["r_CT_H"].tobytes()
        assert values[3:].tobytes() == row["truth"]["q_CH"].tobytes()


@pytest.mark.parametrize("kind", sorted(set(TOPICS.values())))
def test_definition_contains_each_type_that_it_names(kind: str) -> None:
    text = definition(kind)
    assert text.count("MSG: ") == len({line for line in text.splitlines() if line.startswith("MSG: ")})


def test_existing_folder_is_refused(recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["export", str(recorded.path), "--format", "ros2", "-o", str(tmp_path)]) == 2
    assert "give the name of a new folder" in capsys.readouterr().err


def test_failed_export_leaves_nothing_behind(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hil.parts.export.ros2._metadata", fail)
    with pytest.raises(Exception, match="No space left"):
        export_ros2(recorded.path, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_independent_reader_finds_the_numbers_of_the_recording(recorded: Recorded, bag: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    by_topic: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            by_topic.setdefault(connection.topic, []).append((time_ns, message))
    rows, zero_ns = recorded.cycles, start_ns(recorded)
    truth, estimate, imu = rows["truth"], rows["navigation"], rows["imu"]

    def xyz(vector: Any) -> list[float]:
        return [vector.x, vector.y, vector.z]

    def numbers(topic: str, pick: Any) -> np.ndarray:
        return np.array([pick(message) for _, message in by_topic[topic]])

    for k, (time_ns, message) in enumerate(by_topic["/truth/pose"]):
        assert time_ns == zero_ns + round(rows["t_s"][k] * 1e9)
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == time_ns
    assert np.array_equal(numbers("/truth/pose", lambda m: xyz(m.pose.pose.position)), truth["r_CT_H"])
    assert np.array_equal(numbers("/truth/twist", lambda m: xyz(m.twist.linear)), truth["v_CT_H"])
    rates = np.array([in_hill(w, q) for w, q in zip(truth["w_CI_C"], truth["q_CH"], strict=True)])
    assert np.array_equal(numbers("/truth/twist", lambda m: xyz(m.twist.angular)), rates)
    valid = estimate["valid"] == 1
    assert np.array_equal(numbers("/navigation/pose", lambda m: xyz(m.pose.pose.position)), estimate["r_CT_H"][valid])
    sigmas = numbers("/navigation/pose", lambda m: np.diag(m.pose.covariance.reshape(6, 6)))
    assert np.array_equal(sigmas[:, :3], estimate["sigma_r_m"][valid] ** 2)
    assert np.array_equal(numbers("/imu", lambda m: xyz(m.angular_velocity)), imu["rate_C"])
    assert np.array_equal(numbers("/imu", lambda m: xyz(m.linear_acceleration)), imu["force_C"])
    joints = numbers("/joint_states", lambda m: m.position)
    assert np.array_equal(joints, np.hstack([rows["feedback"]["rail_m"], rows["feedback"]["gimbal_rad"]]))
    assert by_topic["/joint_states"][0][1].name == ["x", "y", "z", "roll", "pitch", "yaw"]
    assert np.array_equal(numbers("/thrusters", lambda m: m.effort), rows["command"]["on"])
    assert np.array_equal(numbers("/tf", lambda m: xyz(m.transforms[0].transform.translation)), truth["r_CT_H"])
    fresh = rows["pose"]["fresh"] > 0
    assert np.array_equal(numbers("/vision/pose", lambda m: xyz(m.pose.pose.position)), rows["pose"]["z_TC_C"][fresh])
    texts = [message.status[0].message for _, message in by_topic["/diagnostics"]]
    assert texts == [line["message"] for line in recorded.log]
    assert set(by_topic) <= set(TOPICS)
