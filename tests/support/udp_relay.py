"""A network of the tests' own between a bench and its GNC: loses, delays, reorders, doubles, and can be cut."""

from __future__ import annotations

import heapq
import itertools
import select
import socket
import threading
import time
from typing import Self

import numpy as np


class Relay:
    """Datagrams to ``address`` are forwarded to ``bench``, and its answers back to the last sender.

    loss, duplicate: fractions of the datagrams, each way. delay_s, jitter_s: each datagram is late by the first and a
    part of the second, drawn for each; a jitter longer than the pause between two datagrams reorders them.
    """

    def __init__(
        self,
        bench: tuple[str, int],
        loss: float = 0.0,
        delay_s: float = 0.0,
        jitter_s: float = 0.0,
        duplicate: float = 0.0,
        seed: int = 1,
    ) -> None:
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind(("127.0.0.1", 0))
        self._back.connect(bench)
        self.address: tuple[str, int] = self._front.getsockname()
        self._loss, self._delay_s, self._jitter_s, self._duplicate = loss, delay_s, jitter_s, duplicate
        self._rng = np.random.default_rng(seed)
        self._client: tuple[str, int] | None = None
        self._waiting: list[tuple[float, int, bool, bytes]] = []
        self._numbers = itertools.count()
        self._cut, self._ended = threading.Event(), threading.Event()
        self.lost = self.doubled = self.passed = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def cut(self) -> None:
        """Let nothing pass from now on."""
        self._cut.set()

    def mend(self) -> None:
        """Let everything pass again."""
        self._cut.clear()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._front.close()
        self._back.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            due_s = self._waiting[0][0] - time.monotonic() if self._waiting else 0.02
            for ready in select.select([self._front, self._back], [], [], min(0.02, max(0.0, due_s)))[0]:
                self._take(ready is self._front)
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                _, _, to_bench, datagram = heapq.heappop(self._waiting)
                self._pass_on(to_bench, datagram)

    def _take(self, to_bench: bool) -> None:
        try:
            if to_bench:
                datagram, self._client = self._front.recvfrom(2048)
            else:
                datagram = self._back.recv(2048)
        except OSError:
            return
        if self._cut.is_set() or self._rng.random() < self._loss:
            self.lost += 1
            return
        copies = 1 + int(self._rng.random() < self._duplicate)
        self.doubled += copies - 1
        for _ in range(copies):
            late_s = self._delay_s + self._jitter_s * self._rng.random()
            heapq.heappush(self._waiting, (time.monotonic() + late_s, next(self._numbers), to_bench, datagram))

    def _pass_on(self, to_bench: bool, datagram: bytes) -> None:
        try:
            if to_bench:
                self._back.send(datagram)
            elif self._client is not None:
                self._front.sendto(datagram, self._client)
            self.passed += 1
        except OSError:
            pass
