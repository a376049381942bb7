"""Cost of images: time and size of one, disk space of a run, and the lateness of the loop.

python benchmarks/images.py [--seconds 20] [--loop]

Runs are scheme 1 with rendered vision unit (6.25 pairs of 1024 x 1024 per second) and docking monitor (12.5
frames of 768 x 576 per second). --loop: also on the emulated rig in real time, with and without images, for the
loop's lateness.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from hil.core.camera_images import IMAGE, SLOTS, Encoding, encode, image_row
from hil.frmn.ring import Ring
from hil.recording.images import recorded_images
from hil.recording.writer import RecordingHeader, RunFile

RENDERED = ("vmu.source=rendered", "monitor.source=rendered")
WAYS = {
    "none": ("rig.recording.images=none",),
    "jpeg, two a second (as shipped)": (),
    "jpeg, all": ("rig.recording.image_interval_s=0",),
    "png, all (replays exactly)": ("rig.recording.images=png", "rig.recording.image_interval_s=0"),
}
ENCODINGS: tuple[Encoding, ...] = ("png", "jpeg")
REPEATS = 30


def run(folder: Path, rig: str, seconds: float, *settings: str) -> tuple[Path, dict]:
    """Record a run in ``folder``; return its recording and its numbers."""
    options = [word for setting in (*RENDERED, *settings) for word in ("--set", setting)]
    out = folder / "run.json"
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", rig, "--duration", f"{seconds:g}", *options]
    command += ["--record", str(folder), "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not out.is_file():
        raise SystemExit(done.stderr)
    (path,) = folder.glob("*.mcap")
    return path, json.loads(out.read_text())


def median_ms(action) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def one_picture(path: Path, camera: str) -> None:
    """Print the cost of an image of ``camera`` in the recording at ``path`` in each encoding."""
    image = next(iter(recorded_images(path, camera))).image(path)
    ring = Ring.create(IMAGE, SLOTS, "pictures")
    for encoding in ENCODINGS:
        data = encode(image, encoding)
        row = image_row(camera, 0.0, data, encoding, image.shape[::-1])
        encoding_ms = median_ms(lambda e=encoding: encode(image, e))
        putting_ms = median_ms(lambda r=row: ring.put(r))
        with tempfile.TemporaryDirectory() as folder:
            file = RunFile(Path(folder) / "run.mcap", RecordingHeader({"schema_version": "1"}, {}, 0))
            start = time.perf_counter()
            for _ in range(REPEATS):
                file.write_images(row)
            file.finish({})
            writing_ms = 1e3 * (time.perf_counter() - start) / REPEATS
        print(
            f"{camera:<9} {encoding:<5} {len(data) / 1024:6.0f} KiB  encoding {encoding_ms:5.1f} ms  into the ring "
            f"{putting_ms:4.2f} ms  recorder {writing_ms:4.1f} ms"
        )
    ring.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--loop", action="store_true")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as scratch:
        sizes = {}
        for number, (name, settings) in enumerate(WAYS.items()):
            folder = Path(scratch) / str(number)
            folder.mkdir()
            path, _ = run(folder, "mock", chosen.seconds, *settings)
            sizes[name] = path.stat().st_size
        for camera in ("vmu.left", "monitor"):
            one_picture(path, camera)
        for name, size in sizes.items():
            rate = size / chosen.seconds
            print(f"{name:<32} {1e-6 * rate:6.3f} MB/s  {3600e-9 * rate:6.2f} GB/h")
        for name, settings in WAYS.items() if chosen.loop else ():
            folder = Path(tempfile.mkdtemp(dir=scratch))
            _, found = run(folder, "emulated", chosen.seconds, *settings)
            late, dropped = found["timing"]["lateness_us"], found["recording"]["dropped"]
            lost = found["timing"]["skipped_periods"]
            shown = "  ".join(f"{key} {late[key]:.0f}" for key in ("p50", "p99", "p999", "max"))
            print(f"{name:<32} lateness, us: {shown}  lost periods {lost}  dropped {dropped}  {found['stop']}")


if __name__ == "__main__":
    main()
