"""Renamed keys: earlier names are read wherever raw input enters, with one line that gives the new name."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.body import CentralBody
from hil.config.fmu_mapping import FmuMapping
from hil.config.gnc_override import with_other_gnc
from hil.config.load import Loaded, load_geometry, load_protocol, load_rig, load_scenario, load_scene, shipped
from hil.config.model import ConfigModel
from hil.config.motion_digest import motion_digest
from hil.config.protocol import Protocol
from hil.config.renamed_keys import RENAMED, RENAMED_VALUES, first_names_json, with_first_names, with_present_names
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.console.tuner import Tuner
from hil.errors import BadInput, RenamedKey
from hil.monte_carlo.store import BATCH, Store
from hil.recording import read
from hil.setup.assembly import Job
from hil.setup.live_tuning import with_setting
from hil.vmu.geometry import geometry_of_rig

MODELS: dict[str, type[ConfigModel]] = {
    m.__name__: m for m in (Scenario, Rig, Scene, FmuMapping, Protocol, VmuGeometry, CentralBody)
}


def put(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def at(table: Any, key: str) -> Any:
    for name in key.split("."):
        table = getattr(table, name)
    return table


def keys_of(model: type[ConfigModel], key: str) -> bool:
    """Return whether the model has the dotted key."""
    place: Any = model
    for name in key.split("."):
        if name == "*":
            continue
        if not hasattr(place, "model_fields") or name not in place.model_fields:
            return False
        annotation = place.model_fields[name].annotation
        inner = [a for a in (annotation, *getattr(annotation, "__args__", ())) if hasattr(a, "model_fields")]
        place = inner[0] if inner else None
    return True


def test_table_of_renamed_keys_leads_from_keys_that_are_gone_to_keys_that_exist() -> None:
    assert set(RENAMED) == set(MODELS)
    for name, renamed in RENAMED.items():
        for old, new in renamed.items():
            assert keys_of(MODELS[name], new), new
            assert not keys_of(MODELS[name], old), old
        assert len(set(renamed.values())) == len(renamed)


@pytest.mark.parametrize(
    ("old", "value", "new"),
    [
        ("vmu.loss_share", 0.1, "vmu.loss_probability"),
        ("vmu.duplicate_share", 0.1, "vmu.duplicate_probability"),
        ("vmu.pictures.decoy_lights", 3, "vmu.images.decoy_lights"),
        ("gnc.control.caution", 1.5, "gnc.control.deadband_sigmas"),
        ("gnc.control.attitude_caution", 1.5, "gnc.control.attitude_deadband_sigmas"),
        ("reach.corridor_share", 0.6, "reachability.corridor_fraction"),
        ("reach.catch_up_s", 0.3, "reachability.startup_lag_s"),
        ("monitor.camera_station_m", (0.8, 0.1, 0.0), "monitor.camera_position_m"),
        ("monitor.target_station_m", (0.8, 0.1, 0.0), "monitor.target_position_m"),
    ],
)
def test_earlier_key_of_a_scenario_is_read_from_file_and_option(tmp_path: Path, old: str, value: Any, new: str) -> None:
    text = json.dumps(value)
    path = put(tmp_path / "mine.toml", f'extends = "scheme-1"\n{old} = {text}\n')
    short = new if "pictures" not in old else "vmu.images"
    line = re.escape(f"{path}: {old if short == new else 'vmu.pictures'} is now {short}") + "$"
    with pytest.warns(RenamedKey, match=line) as found:
        assert at(load_scenario(path).value, new) == value
    assert len(found) == 1
    with pytest.warns(RenamedKey, match=r"^--set: .* is now "):
        loaded = load_scenario("scheme-1", [f"{old}={text}"])
    assert at(loaded.value, new) == value
    assert loaded.where(new) == "--set"


@pytest.mark.parametrize(
    ("old", "value", "new"),
    [
        ("host.late_cycle", "hold", "host.on_overrun"),
        ("host.late_cycles_max", 7, "host.overruns_max"),
        ("host.late_cycles_window_s", 2.0, "host.overruns_window_s"),
        ("host.insist_on_realtime", False, "host.require_realtime"),
        ("gnc_link.answer_share", 0.4, "gnc_link.reply_timeout_fraction"),
        ("gnc_link.rejoin_s", 4.0, "gnc_link.reconnect_timeout_s"),
        ("rails.lost_packets_forget_s", 4.0, "rails.lost_packets_window_s"),
        ("turntable.lost_packets_forget_s", 4.0, "turntable.lost_packets_window_s"),
        ("vmu.lost_packets_forget_s", 4.0, "vmu.lost_packets_window_s"),
        ("bench.camera_station_m", (0.5, 0.0, 0.0), "bench.camera_position_m"),
        ("bench.ring_station_m", (0.5, 0.0, 0.0), "bench.led_ring_position_m"),
        ("flight_computer.words", "none", "flight_computer.command_words"),
        ("recording.pictures", "png", "recording.images"),
        ("recording.picture_each_s", 2.0, "recording.image_interval_s"),
    ],
)
def test_earlier_key_of_a_rig_is_read_from_file_and_option(tmp_path: Path, old: str, value: Any, new: str) -> None:
    text = json.dumps(value)
    path = put(tmp_path / "mine.toml", f'extends = "mock"\n{old} = {text}\n')
    with pytest.warns(RenamedKey, match=re.escape(f"{path}: rig.{old} is now rig.{new}") + "$"):
        assert at(load_rig(path).value, new) == value
    with pytest.warns(RenamedKey, match=re.escape(f"--set: rig.{old} is now rig.{new}") + "$"):
        assert at(load_rig("mock", [f"rig.{old}={text}"]).value, new) == value


def test_one_line_per_file_gives_all_its_renamed_keys(tmp_path: Path) -> None:
    base = put(tmp_path / "base.toml", 'extends = "scheme-1"\nvmu.loss_share = 0.1\n')
    path = put(
        tmp_path / "mine.toml",
        """
        extends = "base.toml"
        monitor.target = "reserve"
        console.adjustable = ["gnc.control.caution", "gnc.control.lead_s"]
        [gnc.guidance.phases.ready]
        until_s = 300.0
        [dispersions.vmu]
        loss_share = { kind = "uniform", low = 0.0, high = 0.1 }
        """,
    )
    with pytest.warns(RenamedKey) as found:
        scenario = load_scenario(path).value
    assert [str(warning.message) for warning in found] == [
        f'{path}: monitor.target = "reserve" is now "backup", gnc.control.caution is now gnc.control.deadband_sigmas, '
        "gnc.guidance.phases.ready.until_s is now gnc.guidance.phases.ready.end_time_s, "
        "dispersions.vmu.loss_share is now dispersions.vmu.loss_probability",
        f"{base}: vmu.loss_share is now vmu.loss_probability",
    ]
    assert scenario.monitor.target == "backup"
    assert scenario.console.adjustable == ("gnc.control.deadband_sigmas", "gnc.control.lead_s")
    assert scenario.gnc.guidance.phases["ready"].end_time_s == 300.0
    assert set(scenario.dispersions.vmu) >= {"loss_probability", "latency_s"}


def test_earlier_key_of_a_file_overrides_the_present_one_of_its_base(tmp_path: Path) -> None:
    put(tmp_path / "base.toml", 'extends = "scheme-1"\nvmu.loss_probability = 0.3\n')
    path = put(tmp_path / "mine.toml", 'extends = "base.toml"\nvmu.loss_share = 0.1\n')
    with pytest.warns(RenamedKey):
        loaded = load_scenario(path)
    assert loaded.value.vmu.loss_probability == 0.1
    assert loaded.where("vmu.loss_probability") == path


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "vmu.loss_share = 0.1\nvmu.loss_probability = 0.1",
            "vmu.loss_share: is now vmu.loss_probability, and both are given",
        ),
        (
            "[reach]\ncorridor_share = 0.1\n[reachability]\ncorridor_fraction = 0.1",
            "reach.corridor_share: is now reachability.corridor_fraction, and both are given",
        ),
        ("reach = 3\nreachability.startup_lag_s = 0.1", "reach: is now reachability, and both are given"),
        (
            "[dispersions.vmu]\nloss_share = { kind = 'uniform', low = 0.0, high = 0.1 }\n"
            "loss_probability = { kind = 'uniform', low = 0.0, high = 0.1 }",
            "dispersions.vmu.loss_share: is now dispersions.vmu.loss_probability, and both are given",
        ),
    ],
)
def test_key_under_both_names_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = put(tmp_path / "mine.toml", f'extends = "scheme-1"\n{text}\n')
    with pytest.raises(BadInput) as refused:
        load_scenario(path)
    assert str(refused.value) == f"{path}: {problem}"


def test_options_under_both_names_are_refused() -> None:
    both = ["vmu.loss_share=0.1", "vmu.loss_probability=0.1"]
    for settings in (both, both[::-1]):
        with pytest.raises(BadInput, match=r"^--set: vmu.loss_share: is now vmu.loss_probability, and both are given$"):
            load_scenario("scheme-1", settings)
    with pytest.raises(BadInput, match=r"^--set: rig.host.late_cycle: is now rig.host.on_overrun, and both are given$"):
        load_rig("mock", ["rig.host.late_cycle=log", "rig.host.on_overrun=hold"])


def test_option_may_give_a_whole_table_under_its_earlier_name() -> None:
    with pytest.warns(RenamedKey):
        found = load_scenario("scheme-1", ["reach={corridor_share=0.1, attitude_margin_deg=2.0}"]).value.reachability
    assert (found.corridor_fraction, found.attitude_margin_deg) == (0.1, 2.0)


def test_wrong_value_under_an_earlier_name_is_reported_under_the_present_one(tmp_path: Path) -> None:
    path = put(tmp_path / "mine.toml", 'extends = "scheme-1"\nvmu.loss_share = 2.0\n')
    with pytest.warns(RenamedKey), pytest.raises(BadInput, match=r"mine\.toml: vmu\.loss_probability: 2\.0: must be"):
        load_scenario(path)


def test_scene_protocol_and_geometry_files_are_read_under_earlier_names(tmp_path: Path) -> None:
    atv = Path("configs/targets/atv.toml").read_text()
    path = put(tmp_path / "scene.toml", atv.replace("[backup]", "[reserve]"))
    with pytest.warns(RenamedKey, match="reserve is now backup$"):
        assert load_scene(path).value == load_scene("atv").value
    acu = Path("configs/protocols/acu.toml").read_text()
    earlier = acu.replace("torque_off = 6 # the", "# the").replace("[emulator]", "[emulator]\ntorque_off = 6")
    path = put(tmp_path / "acu.toml", earlier)
    with pytest.warns(RenamedKey, match=r"emulator\.torque_off is now faults\.torque_off$"):
        assert load_protocol(path).value == load_protocol("acu").value
    table = geometry_of_rig(load_rig("mock").value).model_dump(mode="json", exclude_none=True)
    calibration = {
        "id": "a", "date": "2026-03-01", "target": "leds", "views": 1, "rms_px": 0.1, "noise": 1.0,
        "rail_sigma_m": 1e-5, "gimbal_sigma_deg": 0.01, "lever_arm_m": [0, 0, 0], "gimbal_order": "zyx",
        "camera_station_m": [0.6, 0, 0], "camera_axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "target_station_m": [0.1, 0, 0], "target_axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "covariance": [],
    }  # fmt: skip
    path = put(tmp_path / "vmu.json", json.dumps(table | {"calibration": calibration}))
    with pytest.warns(RenamedKey, match=r"calibration\.camera_station_m is now calibration\.camera_position_m"):
        found = load_geometry(path).value.calibration
    assert found is not None
    assert (found.camera_position_m[0], found.target_position_m[0]) == (0.6, 0.1)


@pytest.mark.parametrize("text", ["[gnc.control]\ncaution = 1.0", "[control]\ncaution = 1.0"])
def test_replay_reads_a_gnc_file_and_options_under_earlier_names(tmp_path: Path, text: str) -> None:
    recorded = load_scenario("scheme-1").value
    path = put(tmp_path / "gnc.toml", text)
    with pytest.warns(RenamedKey, match=r"gnc\.toml: gnc\.control\.caution is now gnc\.control\.deadband_sigmas$"):
        assert with_other_gnc(recorded, "run.mcap", path, []).value.gnc.control.deadband_sigmas == 1.0
    with pytest.warns(RenamedKey, match=r"^--set: gnc\.control\.caution"):
        found = with_other_gnc(recorded, "run.mcap", None, ["gnc.control.caution=1.5"]).value
    assert found.gnc.control.deadband_sigmas == 1.5


def test_change_in_flight_may_have_the_earlier_name() -> None:
    scenario = load_scenario("scheme-1")
    tuner = Tuner(Job(scenario, load_rig("mock"), 0, 1.0, 1.0))
    assert tuner.change("gnc.control.caution", 1.0).key == "gnc.control.deadband_sigmas"
    with pytest.warns(RenamedKey):
        changed = with_setting(scenario.value, "gnc.control.caution=1.0", "test").value
    assert changed.gnc.control.deadband_sigmas == 1.0


def test_command_prints_one_line_for_each_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = put(tmp_path / "mine.toml", 'extends = "scheme-1"\nvmu.loss_share = 0.1\nchaser.mass_kg = -1.0\n')
    assert execute(["run", path, "--set", "reach.catch_up_s=0.3"]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"{path}: vmu.loss_share is now vmu.loss_probability",
        "--set: reach.catch_up_s is now reachability.startup_lag_s",
        f"{path}: chaser.mass_kg: -1.0: must be greater than 0",
    ]


def everything(names: Iterable[str], load: Any) -> list[Loaded[Any]]:
    return [load(name) for name in names]


@pytest.mark.parametrize("kind", ["scenarios", "rigs", "targets", "protocols"])
def test_first_names_and_present_names_are_each_others_inverse(kind: str) -> None:
    load = {"scenarios": load_scenario, "rigs": load_rig, "targets": load_scene, "protocols": load_protocol}[kind]
    for loaded in everything(shipped(kind), load):
        name, table = type(loaded.value).__name__, loaded.value.model_dump(mode="json")
        first = with_first_names(name, table)
        assert first != table or (kind == "targets" and "backup" not in table)
        with pytest.warns(RenamedKey, match=r"is now .* \(\d+ more\)$|is now \S+$"):
            back = with_present_names(name, first, "first", named_at_most=1)
        if kind == "rigs":
            back["rails"]["map"]["torque_off"] = table["rails"]["map"]["torque_off"]  # in no digest
        assert type(loaded.value).model_validate_json(json.dumps(back)) == loaded.value
    assert all(key.split(".")[0] in Scenario.model_fields for key in RENAMED_VALUES["Scenario"])


def without_brakes(rig: Rig) -> Rig:
    """Return ``rig`` without the keys of holding brakes, which have been added since."""
    assert rig.io is not None
    z = rig.rails.z.model_copy(update={"gravity_loaded": False, "brake": None})
    io = rig.io.model_copy(update={"torque_delay_s": 0.0})
    return rig.model_copy(update={"rails": rig.rails.model_copy(update={"z": z}), "io": io})


def test_sign_offs_and_campaigns_from_before_a_renaming_stay_valid() -> None:
    digests = {"mock": "7852a5f8b1c56349", "emulated": "8635fa840a21c4b8", "emulated-rtu": "f622794548bb041e"}
    bare = ["rig.bench.bodies=[]", "rig.bench.bodies_distance_m=0.05"]  # as shipped then
    assert {name: motion_digest(without_brakes(load_rig(name, bare).value))[7:23] for name in digests} == digests
    ascii_acu = [*bare, "rig.turntable.driver=ascii", "rig.turntable.ascii.protocol=acu"]
    assert motion_digest(without_brakes(load_rig("emulated", ascii_acu).value))[7:23] == "ba2caa37ef73887b"
    assert motion_digest(load_rig("emulated").value)[7:23] != digests["emulated"]
    text = first_names_json(load_scenario("scheme-1").value)
    assert '"duplicate_share":0.0,"loss_share":0.0,"pictures":{"psf_sigma_px":1.0' in text
    assert '"reach":{"corridor_share":0.25,"attitude_margin_deg":1.0,"catch_up_s":0.2},"monitor":{' in text


def test_campaign_folder_with_columns_of_earlier_names_is_resumed(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    names = ["vmu.loss_probability", "chaser.mass_kg"]
    with Store(tmp_path / "out", {"scenario": "a"}, names) as store:
        row = {field.name: None for field in store.schema} | {"vmu.loss_probability": 0.25, "chaser.mass_kg": 1e3}
        store.put(0, [row | {"case": k, "seed": k} for k in range(BATCH)])
    (part,) = (tmp_path / "out" / "parts").glob("*.parquet")
    table = pq.read_table(part)
    earlier = [name.replace("loss_probability", "loss_share") for name in table.column_names]
    pq.write_table(table.rename_columns(earlier).replace_schema_metadata(table.schema.metadata), part)
    with Store(tmp_path / "out", {"scenario": "a"}, names) as store:
        assert store.missing(BATCH) == []
        store.finish(BATCH)
        assert store.column("vmu.loss_probability").tolist() == [0.25] * BATCH


def test_recording_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    scenario = load_scenario("scheme-1").value
    files = {"scenario.json": first_names_json(scenario)}
    recorded = read.Recorded(
        tmp_path / "run.mcap", {}, None, scenario, load_rig("mock").value, *[np.zeros(0)] * 3, [], None, True, files
    )
    with pytest.warns(RenamedKey, match=r"run\.mcap: scenario\.json: \S+ is now \S+ \(\d+ more\)$"):
        assert recorded.calibration("scenario.json", Scenario) == scenario
    note = {"kind": "setting", "name": "ann", "cycle": 3, "message": "gnc.control.caution=1.5"}
    assert read.present_note(note)["message"] == "gnc.control.deadband_sigmas=1.5"
    order = {"kind": "order", "message": "go"}
    assert read.present_note(order) == order
