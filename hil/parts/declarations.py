"""Parts of this package: the core's commands, and capabilities of a bench in addition to its core.

``hil.core.part`` reads this list by its name: nothing imports it, and it imports no part.
"""

from __future__ import annotations

from typing import Final

from hil.core.part import Part, PartCommand, PartSink

CORE: Final = Part(
    name="core",
    summary="Closed loop of a scenario on a rig: run, safety, recording, replay, report.",
    commands={
        "run": PartCommand(
            "hil.cli.run:run",
            "Run one closed loop and print its verdict.",
            "hil run scheme-1 --seed 7 --set gnc.control.deadband_m=0.004 --record runs",
        ),
        "init": PartCommand(
            "hil.cli.init:init",
            "Write a repository: scenario, rig, GNC in C and Python, test campaign, pipelines; or a part, or a driver.",
            "hil init approach",
        ),
        "preflight": PartCommand(
            "hil.cli.preflight:preflight",
            "Check whether this host and a rig can run in real time and reach a scenario; exit code 0 or 1.",
            "hil preflight --rig lab.toml --json preflight.json",
        ),
        "replay": PartCommand(
            "hil.cli.replay:replay",
            "Replay the recorded inputs of a run through the present GNC and compare bit by bit.",
            "hil replay RUN.mcap --set gnc.navigation.noise_scale=2",
        ),
        "recover": PartCommand(
            "hil.cli.recover:recover",
            "Restore a truncated recording in a new file; the file itself stays unchanged.",
            "hil recover RUN.mcap -o restored.mcap",
        ),
        "vehicle": PartCommand(
            "hil.cli.vehicle:vehicle",
            "Compare the vehicle of a scenario with its plan, Table III, and abort.",
            "hil vehicle scheme-1 --json vehicle.json",
        ),
        "warm-up": PartCommand(
            "hil.cli.warm_up:warm_up",
            "Compile all kernels for this computer, and print the time that each group of them takes.",
            "hil warm-up",
        ),
        "list": PartCommand(
            "hil.cli.list:list",
            "List what a command takes by name: scenarios, rigs, dispersions, drivers, backends, sensors, parts.",
            "hil list scenarios",
        ),
        "keys": PartCommand(
            "hil.cli.keys:keys",
            "List the keys of scenario and rig files that --set takes, with unit, range, default and meaning.",
            "hil keys deadband",
        ),
        "report": PartCommand(
            "hil.cli.report:report",
            "Write a self-contained HTML report of a run, of a campaign, or a comparison of several runs.",
            "hil report RUN.mcap -o run.html",
        ),
        "recordings": PartCommand(
            "hil.cli.recordings:app",
            "Recorded runs.",
            "hil recordings list runs",
        ),
        "sensors": PartCommand(
            "hil.cli.sensors:app",
            "Sensor modules that a scenario can add: list them, check one.",
            "hil sensors check range_finder",
        ),
    },
)

VISION: Final = Part(
    name="vision",
    summary="Vision unit: poses from images of LEDs or printed boards, and its calibration.",
    commands={
        "vmu": PartCommand(
            "hil.parts.vision.cli.vmu:vmu",
            "Compute poses with status and sigma from LED images (left/NNNN.png, right/NNNN.png), one row per frame.",
            "hil vmu images --geometry vmu.toml --out poses.csv",
        ),
        "targets": PartCommand(
            "hil.parts.vision.cli.targets:app", "Targets of the vision unit: print their sheets.",
            "hil targets print apriltag -o sheet.pdf",
        ),
        "calibrate": PartCommand(
            "hil.parts.vision.cli.calibrate:calibrate",
            "Calibrate the vision unit from views at known bench positions, or check an earlier calibration for drift.",
            "hil calibrate views --out vmu.toml",
        ),
    },
    provides={"replay of images": "hil.parts.vision.cli.replay_images:replay_images"},
    uses=lambda scenario, rig: bool(rig.vmu.drift_check.views),
    check_run="hil.parts.vision.drift_views:check_drift_views",
    attach="hil.parts.vision.calibration_drive:attach",
    kernels={"vmu": "hil.parts.vision.rendered_vision:compile_kernels"},
    opencv=True,
    modules=("hil.vmu",),
)  # fmt: skip

CAMPAIGNS: Final = Part(
    name="campaigns",
    summary="Many runs: dispersions, rare events, sensitivities, requirements, benchmarks, tests of a test campaign.",
    commands={
        "campaign": PartCommand(
            "hil.parts.campaigns.cli.campaign:campaign",
            "Run many cases of a scenario with its dispersions on the mock rig: pass rate, worst cases, why cases "
            "fail.",
            "hil campaign scheme-1 --runs 200 --out results",
        ),
        "explain": PartCommand(
            "hil.parts.campaigns.cli.explain:explain",
            "Explain why cases of a campaign fail, or a recorded run: the first violated limit, its drivers and "
            "thresholds.",
            "hil explain results --case 25",
        ),
        "margins": PartCommand(
            "hil.parts.campaigns.cli.margins:margins",
            "Search how much later poses, stamps, thrusters and axes may be before the first case of a campaign "
            "fails.",
            "hil margins scheme-1 --runs 20",
        ),
        "benchmark": PartCommand(
            "hil.parts.campaigns.cli.benchmark:benchmark",
            "Fly all scenarios, dispersion sets and single faults with one GNC, and write one table and one page.",
            "hil benchmark builtin --out benchmark",
        ),
        "fusion": PartCommand(
            "hil.parts.campaigns.cli.fusion:fusion",
            "Simulate the fusion filters over many runs (bench paper IV.A): errors, bound, ratio, NEES.",
            "hil fusion --runs 200 --json fusion.json",
        ),
        "ci": PartCommand(
            "hil.parts.campaigns.cli.ci:ci",
            "Run a campaign on the mock rig and a run in lock-step, judge requirements and tests, compare with the "
            "base.",
            "hil ci scenarios/approach.toml --out results",
        ),
        "recordings place": PartCommand(
            "hil.parts.campaigns.cli.campaign_recordings:place_recordings",
            "Place recorded runs in the distribution of a campaign.",
            "hil recordings place RUN.mcap --campaign results",
        ),
    },
    provides={
        "case": "hil.parts.campaigns.api.campaign_results:campaign_case",
        "report of a campaign": "hil.parts.campaigns.page:write_page",
        "evidence of recordings": "hil.parts.campaigns.cli.campaign_recordings:add_to_evidence",
    },
    kernels={"fusion": "hil.parts.campaigns.fusion:compile_kernels"},
)  # fmt: skip

WIRES: Final = Part(
    name="wires",
    summary="Drivers of rails, turntables, digital I/O and sensors on wires, their I/O process and its watchdog.",
    provides={
        "rig.kind=hardware": "hil.parts.wires.wired:wired_bench",
        "rig.kind=hardware: locks": "hil.drivers.wire_lock:locked_wires",
        "rig.kind=hardware: preflight": "hil.parts.wires.devices:hardware_checks",
        "rig.turntable.driver=cia402: description": "hil.drivers.turntable.cia402.describe:describe",
    },
    uses=lambda scenario, rig: rig.kind != "mock",
    check_rig="hil.parts.wires.devices:check_clock",
    check_run="hil.drivers.wire_lock:wires_in_use",
    modules=(
        "hil.drivers.arm.device", "hil.drivers.arm.entry",
        "hil.drivers.checksums", "hil.drivers.cyclic_exchange", "hil.drivers.datagrams", "hil.drivers.io.codec",
        "hil.drivers.imu", "hil.drivers.io.coupler", "hil.drivers.io.driver", "hil.drivers.io.entry",
        "hil.drivers.line_sensor", "hil.drivers.loop_thread",
        "hil.drivers.ptp", "hil.drivers.rails", "hil.drivers.remote", "hil.drivers.returned",
        "hil.drivers.can_port", "hil.drivers.serial_port", "hil.drivers.split_axes", "hil.drivers.turntable",
        "hil.drivers.vmu.codec", "hil.drivers.vmu.codecs", "hil.drivers.vmu.driver", "hil.drivers.vmu.entry",
        "hil.drivers.vmu.frame_codec", "hil.drivers.vmu.sender", "hil.drivers.vmu.text_codec",
        "hil.drivers.vmu.unit_clock", "hil.drivers.wire_lock",
    ),
)  # fmt: skip

MONITOR: Final = Part(
    name="monitor",
    summary="Docking monitor: range and angles from the images of a television camera.",
    commands={
        "monitor": PartCommand(
            "hil.parts.monitor.cli:monitor",
            "Measure range, range rate and angles on the video of an approach, each with its standard deviation.",
            "hil monitor approach.mp4 --scene atv --out portions.csv",
        ),
    },
    tables={"monitor": "", "rig.monitor_camera": ""},
    provides={"monitor.source": "hil.parts.monitor.params:monitor_sensor"},
    uses=lambda scenario, rig: scenario.monitor.has_images,
    attachments="hil.parts.monitor.session:attachments",
    attach="hil.parts.monitor.session:attach",
    kernels={"monitor": "hil.parts.monitor.session:compile_kernels"},
    opencv=True,
    sections={"monitor": "hil.parts.monitor.report:monitor_section"},
    sinks={
        "portions": PartSink(64, "/monitor/portions", "hil.Portion", "hil.parts.monitor.results:PORTION_FIELDS"),
        "monitor_images": PartSink(16),
    },
)  # fmt: skip

CONSOLE: Final = Part(
    name="console",
    summary="Console: the page that displays and commands a session, its operators, and live viewers.",
    commands={
        "console": PartCommand(
            "hil.parts.console.cli.console:console",
            "Serve the page that displays and commands a session at the bench, until Ctrl-C.",
            "hil console --rig emulated",
        ),
        "operators": PartCommand(
            "hil.parts.console.cli.operators:app",
            "Keys of the operators of a console.",
            "hil operators add NAME",
        ),
    },
)

EMULATION: Final = Part(
    name="emulation",
    summary="Emulators of all devices on their wires, with faults, by the wall clock or in lock-step.",
    commands={
        "emulate": PartCommand(
            "hil.parts.emulation.cli:emulate",
            "Start the emulated devices of a rig, print their addresses, and run until Ctrl-C.",
            "hil emulate emulated",
        ),
    },
    provides={
        "rig.kind=emulated": "hil.parts.emulation.session:emulated_bench",
        "rig.kind=emulated: preflight": "hil.parts.emulation.preflight:emulated_checks",
        "rig.kind=emulated: operator": "hil.parts.emulation.operator:AutoOperator",
        "rig.kind=emulated: faults": "hil.parts.emulation.fault_injection:FaultControl",
        "rig.host.time=lock_step": "hil.parts.emulation.lock_step:LockStepClock",
        "rig.host.time=lock_step: serial": "hil.parts.emulation.counted_serial:CountedSerial",
    },
)  # fmt: skip

CAMERAS: Final = Part(
    name="cameras",
    summary="Cameras by GenICam, GenTL and V4L2, and rendered ones.",
    commands={
        "cameras": PartCommand(
            "hil.parts.cameras.cli.cameras:app",
            "Cameras of the vision unit: find them, show their images, focus their lenses.",
            "hil cameras list",
        ),
    },
    provides={"vmu.source=rendered": "hil.parts.cameras.pose_sensor:rendered_pose_sensor"},
    uses=lambda scenario, rig: scenario.vmu.source in ("rendered", "cameras"),
    attachments="hil.parts.cameras.pose_sensor:attachments",
    modules=("hil.drivers.cameras",),
)

LINKS: Final = Part(
    name="links",
    summary="GNC on another computer: UDP datagrams, command words, and the check of a GNC.",
    commands={
        "gnc": PartCommand(
            "hil.parts.links.cli.gnc:app",
            "Run the GNC of a scenario for a bench in another process or on another computer, until the bench "
            "disconnects.",
            "hil gnc check ./libgnc.so",
        ),
        "dss": PartCommand(
            "hil.parts.links.cli.dss:dss",
            "Run the bench, with dynamics and vision unit, for a GNC in another process or on another computer.",
            "hil dss scheme-1 --gnc 192.168.0.2:5010",
        ),
    },
    tables={"rig.flight_computer": "", "rig.gnc_link": ""},
    provides={"rig.flight_computer.command_words": "hil.parts.links.command_words:command_word_gnc"},
)  # fmt: skip

FMI: Final = Part(
    name="fmi",
    summary="Functional mock-up units: GNC and parts of the plant in FMUs, the bench as an FMU.",
    commands={
        "fmu-export": PartCommand(
            "hil.parts.fmi.cli:fmu_export",
            "Write truth, sensors, thrusters and mock axes of one run as an FMU for co-simulation.",
            "hil fmu-export scheme-1 -o plant.fmu",
        ),
    },
    provides={
        "gnc.fmu": "hil.parts.fmi.isolated:open_fmu",
        "backend in an FMU": "hil.parts.fmi.backend:FmuBackend",
        "models": "hil.parts.fmi.plant_models:model_stage",
    },
    uses=lambda scenario, rig: bool(scenario.models),
    check_run="hil.parts.fmi.plant_models:check_models",
)  # fmt: skip

COMMISSIONING: Final = Part(
    name="commissioning",
    summary="First power-up of a rig, its identification and its sign-off.",
    commands={
        "identify": PartCommand(
            "hil.parts.commissioning.cli.identify:identify",
            "Move one axis at a time, a few millimetres or tenths of a degree, and measure its delay and bandwidth.",
            "hil identify lab.toml --out identified.toml",
        ),
        "commission": PartCommand(
            "hil.parts.commissioning.cli.commission:commission",
            "Take a rig from its emergency stop, one axis at a time, to a slow dry run, and sign it off.",
            "hil commission lab.toml --out signed.toml",
        ),
    },
)

GEOMETRY: Final = Part(
    name="geometry",
    summary="Geometry of the bench: plan of poses, measurement, bundle fit, drift check.",
    commands={
        "geometry": PartCommand(
            "hil.parts.geometry.cli:app",
            "Geometry of the bench: plan poses, measure them, fit the parameters, check for drift.",
            "hil geometry plan lab.toml -o plan.csv",
        ),
    },
    uses=lambda _, rig: rig.bench.geometry_file is not None and rig.table_of_part("tracker") is None,
    attach="hil.parts.geometry.budget:attach",
)

EXPORT: Final = Part(
    name="export",
    summary="Recordings for other programs: Parquet, CSV, images, bags of ROS 2.",
    commands={
        "export": PartCommand(
            "hil.parts.export.cli:export",
            "Write the numbers of a recording as Parquet or CSV, its camera images, or all of it as a bag of ROS 2.",
            "hil export RUN.mcap --format ros2 -o bag",
        ),
    },
    provides={"table of cycles": "hil.parts.export.table:write_cycles"},
)

TRACKER: Final = Part(
    name="tracker",
    summary="Motion capture or laser tracker that checks the bench during a run: NatNet, Qualisys RT, frames of text.",
    tables={"rig.tracker": "hil.parts.tracker.table:Tracker"},
    check_run="hil.parts.tracker.session:check_run",
    attach="hil.parts.tracker.session:attach",
    each_cycle=True,
    preflight="hil.parts.tracker.preflight:checks",
    sinks={
        "tracker_samples": PartSink(
            1024,
            "/tracker",
            "hil.TrackerSample",
            "hil.parts.tracker.rows:SAMPLE_FIELDS",
            "hil.parts.tracker.rows:offsets",
        )
    },
    sections={"bench_truth": "hil.parts.tracker.results:section"},
)

PARTS: Final = (
    CORE, VISION, CAMPAIGNS, WIRES, MONITOR, CONSOLE, EMULATION, CAMERAS, LINKS, FMI, COMMISSIONING, GEOMETRY, EXPORT,
    TRACKER,
)  # fmt: skip
