"""Draw docs/pictures/viewers.png from what viewers receive: ``python -m sims.viewer_picture [OUT.png]``.

It is drawn by this script, neither by Foxglove nor by ROS: from a run of scheme 1, the scene and the transforms of its
recording, the plots of the shipped layout, and the estimated poses of its export as a bag of ROS 2.
"""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mcap.reader import make_reader
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

import hil
from hil.maths import quat
from hil.parts.export.ros2 import export_ros2

_COLOURS = ("#0072b2", "#e69f00", "#009e73")
_SHOWN_AT_S = 40.0


def json_messages(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the JSON messages of a recording by topic."""
    found: dict[str, list[dict[str, Any]]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.message_encoding == "json":
                found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found


def bag_poses(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (n,), s since the first, of a topic of a bag, and its positions with their sigmas, m, (n, 6)."""
    rows = []
    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=[topic]):
            (length,) = struct.unpack_from("<I", message.data, 12)
            place = 4 + -(-(12 + length) // 8) * 8  # aligned after the four bytes of the encapsulation
            numbers = np.frombuffer(message.data, "<f8", 43, place)
            rows.append((message.log_time, *numbers[:3], *np.sqrt(np.diag(numbers[7:].reshape(6, 6))[:3])))
    table = np.array(rows)
    return (table[:, 0] - table[0, 0]) * 1e-9, table[:, 1:]


def _corners(solid: dict[str, Any], r: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the corners (8, 3) of a cube of the scene in H; r, q: pose of its frame, q takes the frame to H."""
    size, pose = solid["size"], solid["pose"]
    half = 0.5 * np.array([size["x"], size["y"], size["z"]])
    own = np.array([pose["orientation"][k] for k in "xyzw"])
    place = np.array([pose["position"][k] for k in "xyz"])
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return np.array([r + quat.transform_back(q, place + quat.transform_back(own, sign * half)) for sign in signs])


_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def draw_scene(axes: Any, scene: dict[str, Any], transforms: list[dict[str, Any]]) -> None:
    """Draw the scene with the chaser at one time, and its path."""
    path = np.array([[t["translation"][k] for k in "xyz"] for t in transforms])
    shown = transforms[round(10.0 * _SHOWN_AT_S)]
    frames = {"H": (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))}
    r, q = (np.array([shown[part][k] for k in keys]) for part, keys in (("translation", "xyz"), ("rotation", "xyzw")))
    frames["chaser"] = (r, q)
    for entity in scene["entities"]:
        r, q = frames[entity["frame_id"]]
        for cube in entity["cubes"]:
            corners = _corners(cube, r, q)
            colour = tuple(cube["color"][k] for k in "rgb")
            faces = [corners[list(face)] for face in _FACES]
            axes.add_collection3d(Poly3DCollection(faces, facecolor=(*colour, 0.35), edgecolor=colour, linewidth=0.6))
        for lines in entity["lines"]:
            points = np.array([[p[k] for k in "xyz"] for p in lines["points"]])
            axes.add_collection3d(Line3DCollection(points.reshape(-1, 2, 3), colors="#aaaaaa", linewidths=0.5))
        for sphere in entity["spheres"]:
            centre = [sphere["pose"]["position"][k] for k in "xyz"]
            axes.scatter(*centre, color=_COLOURS[2], s=18)
    axes.plot(*path.T, color=_COLOURS[0], linewidth=1.0)
    axes.set(xlim=(0, 5.4), ylim=(-1.4, 1.4), zlim=(1.4, -1.4), xlabel="x, m", ylabel="y, m", zlabel="z, m")
    axes.set_box_aspect((5.4, 2.8, 2.8))
    axes.view_init(elev=22, azim=-62)
    axes.set_title(f"/scene and /tf at {_SHOWN_AT_S:g} s", fontsize=9)


def _plot(axes: Any, states: list[dict[str, Any]], key: str, title: str) -> None:
    t_s = np.array([state["t_s"] for state in states])
    for i, axis in enumerate("xyz"):
        values = np.array([state[key][i] if state[key][i] is not None else np.nan for state in states])
        axes.plot(t_s, values, color=_COLOURS[i], linewidth=0.8, label=axis)
    axes.set_title(title, fontsize=9)
    axes.legend(loc="upper right", fontsize=7)


def main(out: str = "docs/pictures/viewers.png") -> None:
    """Fly, export, draw."""
    with tempfile.TemporaryDirectory() as folder:
        hil.run("scheme-1", record=folder)
        recording = next(Path(folder).glob("*.mcap"))
        export_ros2(recording, Path(folder) / "bag")
        found = json_messages(recording)
        bag_s, pose = bag_poses(next((Path(folder) / "bag").glob("*.mcap")), "/navigation/pose")
    figure = plt.figure(figsize=(11.0, 6.0), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1.0))
    draw_scene(figure.add_subplot(grid[:, 0], projection="3d"), found["/scene"][0], found["/tf"])
    _plot(figure.add_subplot(grid[0, 1]), found["/state"], "position_m", "/state.position_m, of the recording or live")
    axes = figure.add_subplot(grid[1, 1])
    for i, axis in enumerate("xyz"):
        axes.plot(bag_s, 3e3 * pose[:, 3 + i], color=_COLOURS[i], linewidth=0.8, label=f"3 sigma {axis}, mm")
    axes.set(title="/navigation/pose of the bag of ROS 2", xlabel="t, s", ylim=(0.0, 30.0))
    axes.title.set_fontsize(9)
    axes.legend(fontsize=7)
    figure.savefig(out)


if __name__ == "__main__":
    main(*sys.argv[1:2])
