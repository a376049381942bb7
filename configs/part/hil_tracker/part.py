"""Declaration of the part. Modules are imported when their functions are called."""

from hil.core.part import Part, PartCommand, PartSink

PART = Part(
    name="tracker",
    summary="Samples of the distance between chaser and target.",
    tables={"tracker": "hil_tracker.table:Tracker"},
    commands={"tracker": PartCommand("hil_tracker.command:tracker", "Print the samples of a recorded run.")},
    sinks={"tracker_samples": PartSink(1024, "/tracker", "tracker.Sample", "hil_tracker.session:SAMPLE_FIELDS")},
    attach="hil_tracker.session:attach",
    sections={"tracker": "hil_tracker.session:section"},
)
