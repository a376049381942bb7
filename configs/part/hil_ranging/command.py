"""Command ``hil ranging``."""

import hil


def ranging(recording: str, /) -> None:
    """Print the samples of a recorded run.

    Parameters
    ----------
    recording
        File of the recording.
    """
    samples = hil.open(recording).rows_of("ranging_samples")
    for t_s, range_m in zip(samples.t_s, samples.range_m, strict=True):
        print(f"{t_s:8.2f} s {range_m:8.3f} m")
