"""Declaration of the part. Modules are imported when their functions are called."""

from hil.core.part import Part, PartCommand, PartSink

PART = Part(
    name="ranging",
    summary="Samples of the distance between chaser and target.",
    tables={"ranging": "hil_ranging.table:Ranging"},
    commands={
        "ranging": PartCommand(
            "hil_ranging.command:ranging", "Print the samples of a recorded run.", "hil ranging recordings/RUN.mcap"
        )
    },
    sinks={"ranging_samples": PartSink(1024, "/ranging", "ranging.Sample", "hil_ranging.session:SAMPLE_FIELDS")},
    attach="hil_ranging.session:attach",
    sections={"ranging": "hil_ranging.session:section"},
)
