"""Write the shipped layout for Foxglove: ``python -m sims.foxglove_layout > configs/foxglove/layout.json``.

3-D scene, images with overlays, state and errors, mode, HOLD and STOP, settings and log, of a bench or a recording.
"""

from __future__ import annotations

import json
from typing import Any

import foxglove.layouts as fl

from hil.recording.foxglove_images import ANNOTATIONS, PICTURE_TOPICS

_KINDS = {"ThreeDee": "3D", "ServiceCall": "CallService", "Log": "RosOut"}  # in files of the application
_AXES = "xyz"
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#888888")  # as on the console's page
_MODES = {"running": "#009e73", "hold": "#e69f00", "safe-stop": "#d55e00", "standby": "#0072b2", "armed": "#56b4e9"}


def layout() -> fl.Layout:
    """Return the layout."""
    return fl.Layout(
        content=_row(
            (3, _column((3, _scene()), (2, _row((1, _image("vmu.left")), (1, _image("vmu.right")))))),
            (
                3,
                _column(
                    (1, _plot("Position in H, m", _three("/state.position_m", "truth"))),
                    (1, _plot("Estimation error, mm", [*_three("/state.error_mm", "error"), *_bands()])),
                    (1, _plot("Margins", _one("/state.corridor_margin_m", "/state.closing_margin_mps"))),
                    (
                        1,
                        _plot(
                            "NIS and thrusters",
                            _one("/state.nis_position", "/state.nis_attitude", "/state.thrusters_on"),
                        ),
                    ),
                    (1, _plot("Lateness, us", _one("/state.lateness_us"))),
                ),
            ),
            (
                2,
                _column(
                    (1, _row((2, _mode()), (1, _button("hold", "#e69f00")), (1, _button("stop", "#d55e00")))),
                    (2, _services()),
                    (3, fl.ParametersPanel(title="Settings in flight")),
                    (3, fl.LogPanel(title="Events", config=fl.LogConfig(topic_to_render="/log", show_name=True))),
                ),
            ),
        )
    )


def _row(*items: tuple[float, Any]) -> fl.SplitContainer:
    return _split("row", items)


def _column(*items: tuple[float, Any]) -> fl.SplitContainer:
    return _split("column", items)


def _split(direction: Any, items: tuple[tuple[float, Any], ...]) -> fl.SplitContainer:
    parts = [fl.SplitItem(proportion=proportion, content=content) for proportion, content in items]
    return fl.SplitContainer(direction=direction, items=parts)


def _scene() -> fl.ThreeDeePanel:
    camera = fl.ThreeDeeCameraState(distance=9.0, phi=65.0, theta_offset=60.0, target_offset=(2.0, 0.0, 0.0), fovy=45.0)
    scene = fl.BaseRendererSceneUpdateTopicSettings(visible=True)
    config = fl.ThreeDeeConfig(camera_state=camera, follow_tf="H", follow_mode="follow-none", topics={"/scene": scene})
    return fl.ThreeDeePanel(title="Chaser, target and corridor in H", config=config)


def _image(camera: str) -> fl.ImagePanel:
    topic = f"{PICTURE_TOPICS}{camera}"
    annotations = {f"{topic}{ANNOTATIONS}": fl.ImageAnnotationSettings(visible=True)}
    mode = fl.ImageModeConfig(image_topic=topic, annotations=annotations)
    return fl.ImagePanel(title=f"Camera {camera}", config=fl.ImageConfig(image_mode=mode))


def _plot(title: str, series: list[fl.PlotSeries]) -> fl.PlotPanel:
    return fl.PlotPanel(title=title, config=fl.PlotConfig(paths=series, show_legend=True, legend_display="floating"))


def _three(path: str, name: str) -> list[fl.PlotSeries]:
    return [
        fl.PlotSeries(value=f"{path}[{i}]", label=f"{name} {axis}", color=_COLOURS[i], line_size=1.5)
        for i, axis in enumerate(_AXES)
    ]


def _bands() -> list[fl.PlotSeries]:
    return [
        fl.PlotSeries(value=f"/state.sigma_mm[{i}]", label=f"sigma {axis}", color=_COLOURS[i], line_style="dashed")
        for i, axis in enumerate(_AXES)
    ]


def _one(*paths: str) -> list[fl.PlotSeries]:
    return [
        fl.PlotSeries(value=path, label=path.partition(".")[2], color=_COLOURS[i], line_size=1.5)
        for i, path in enumerate(paths)
    ]


def _mode() -> fl.IndicatorPanel:
    rules = [fl.IndicatorRule(operator="=", raw_value=mode, color=c, label=mode) for mode, c in _MODES.items()]
    config = fl.IndicatorConfig(path="/bench.mode", style="background", rules=rules, fallback_color="#888888")
    return fl.IndicatorPanel(title="Mode", config=config)


def _button(name: str, colour: str) -> fl.ServiceCallPanel:
    config = fl.ServiceCallConfig(
        service_name=f"/hil/{name}",
        request_payload="{}",
        button_text=name.upper(),
        button_color=colour,
        editing_mode=False,
    )
    return fl.ServiceCallPanel(title=name.capitalize(), config=config)


def _services() -> fl.ServiceCallPanel:
    config = fl.ServiceCallConfig(
        service_name="/hil/take", request_payload='{"name": "", "code": ""}', button_text="Call", editing_mode=True
    )
    return fl.ServiceCallPanel(title="Command and other services", config=config)


def importable(content: dict[str, Any]) -> dict[str, Any]:
    """Return the layout as the application imports and exports it: panels by number, splits in two."""
    panels: dict[str, Any] = {}

    def place(node: dict[str, Any]) -> Any:
        if node["type"] == "split":
            return halves(node["direction"], node["items"])
        kind = _KINDS.get(node["panelType"], node["panelType"])
        name = f"{kind}!{len(panels) + 1}"
        panels[name] = {**node.get("config", {}), "foxglovePanelTitle": node["title"]}
        return name

    def halves(direction: str, items: list[dict[str, Any]]) -> Any:
        first, *others = items
        if not others:
            return place(first["content"])
        share = first["proportion"] / sum(item["proportion"] for item in items)
        return {
            "direction": direction,
            "first": place(first["content"]),
            "second": halves(direction, others),
            "splitPercentage": round(100.0 * share, 1),
        }

    tree = place(content)
    rest = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return {"configById": panels, **rest, "layout": tree}


def text() -> str:
    """Return the layout's file."""
    return json.dumps(importable(json.loads(layout().to_json())["content"]), indent=1) + "\n"


if __name__ == "__main__":
    print(text(), end="")
