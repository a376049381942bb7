"""Datagrams of a program of the user's own as samples of a sensor."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hil.config.tables.sensors import SensorConfig
from hil.errors import BadInput
from hil.parts.wires.sensors import UdpSamples

NOW_S, BENCH_S, ZERO_S = 1000.0, 50.0, 20.0


def source(stamp: str = "capture", latency_s: float = 0.0) -> UdpSamples:
    config = SensorConfig.model_validate(
        {"kind": "x", "source": "udp", "port": 1, "stamp": stamp, "latency_s": latency_s}, strict=False
    )
    return UdpSamples("mocap", 2, 2, config.model_copy(update={"port": 0}), lambda: NOW_S)


@pytest.fixture
def samples() -> Iterator[UdpSamples]:
    found = source()
    yield found
    found.close()


def send(to: UdpSamples, content: Any) -> None:
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(data, ("127.0.0.1", to.port))


def good(**changes: Any) -> dict[str, Any]:
    return {"t_s": NOW_S - 0.08, "value": [1.0, 2.0], "covariance": [[1e-4, 0.0], [0.0, 4e-4]]} | changes


def test_stamp_of_capture_is_the_moment_of_the_measurement(samples: UdpSamples) -> None:
    send(samples, good())
    (row,) = samples.poll(BENCH_S, ZERO_S).view(np.recarray)
    assert row.sensor == 2
    assert row.received_s == 30.0
    assert row.t_s == pytest.approx(30.0 - 0.08)
    np.testing.assert_array_equal(row.value, [1.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    assert row.covariance[1, 1] == 4e-4


def test_stamp_is_not_read_if_it_means_the_receipt() -> None:
    found = source("receipt", 0.06)
    send(found, good(t_s="noon"))
    (row,) = found.poll(BENCH_S, ZERO_S).view(np.recarray)
    found.close()
    assert row.t_s == pytest.approx(30.0 - 0.06)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\xff\x00", "no object"),
        (b"[" * 4000, "no object"),
        ([1, 2], "no object"),
        (b"x" * 5000, "longer than"),
        ({"t_s": 1.0}, "no object"),
        (good(value=[1.0]), "must have 2 components"),
        (good(value=[1.0, float("nan")]), "not finite"),
        (good(covariance=[[1.0, 0.0], [0.0, -1.0]]), "positive definite"),
        (good(covariance=[[1.0, 0.5], [0.0, 1.0]]), "symmetric"),
        (good(status=3), "status 3"),
        (good(t_s=NOW_S + 1.0), "in the future"),
        (good(t_s=True), "no number"),
        (good(t_s=None), "no number"),
    ],
)
def test_datagram_that_cannot_be_used_is_counted_and_goes_no_further(
    samples: UdpSamples, content: Any, reason: str
) -> None:
    send(samples, content)
    assert len(samples.poll(BENCH_S, ZERO_S)) == 0
    assert [reason in text for text in samples.refused] == [True]
    send(samples, good())
    assert len(samples.poll(BENCH_S, ZERO_S)) == 1


def test_measurement_of_before_the_run_is_not_used(samples: UdpSamples) -> None:
    send(samples, good())
    assert len(samples.poll(ZERO_S + 0.05, ZERO_S)) == 0
    assert samples.refused == {"measured before the run": 1}


def test_repeated_stamp_is_refused(samples: UdpSamples) -> None:
    send(samples, good())
    send(samples, good())
    assert len(samples.poll(BENCH_S, ZERO_S)) == 1
    assert samples.refused == {"t_s repeats": 1}


def test_port_in_use_names_the_key(samples: UdpSamples) -> None:
    config = SensorConfig.model_validate({"kind": "x", "source": "udp", "port": samples.port, "stamp": "capture"})
    with pytest.raises(BadInput, match=r"sensors.mocap.port"):
        UdpSamples("mocap", 0, 2, config)
