"""Compiled loop on a CUDA GPU, one case per thread.

Each argument of ``run_cycles`` that differs between cases is an array with a leading axis of cases. A launch runs all
cases that have not ended to the same cycle, so that the IMU's noise is in memory for the cycles of one launch only.
"""

from __future__ import annotations

import importlib
from typing import Any

from hil.core.jit import kernel_cache_folder, prepare_kernel_cache
from hil.core.kernel_digest import digest_of
from hil.loop.compiled.run_cycles import COMPLETED, run_cycles

cuda: Any = importlib.import_module("numba.cuda")


class _Locator:
    """Place of the code for GPUs in the kernel cache, for numba's cache."""

    def __init__(self, function: Any) -> None:
        self._name = function.__name__

    @classmethod
    def from_function(cls, function: Any, _file: str) -> _Locator | None:
        return cls(function) if function.__module__ == __name__ else None

    def get_cache_path(self) -> str:
        return str(kernel_cache_folder() / "cuda")

    def ensure_cache_path(self) -> None:
        prepare_kernel_cache()
        (kernel_cache_folder() / "cuda").mkdir(exist_ok=True)

    def get_source_stamp(self) -> str:
        return digest_of(run_cycles)

    def get_disambiguator(self) -> str:
        return f"{self._name}-{digest_of(run_cycles)}"


if not cuda.config.ENABLE_CUDASIM:  # the simulator compiles nothing
    caching: Any = importlib.import_module("numba.cuda.core.caching")
    caching.CacheImpl._locator_classes.insert(0, _Locator)


@cuda.jit(cache=True)
def clear_words(words):
    """Set ``words`` (n, m) to zero, one row per block."""
    words[cuda.blockIdx.x, cuda.threadIdx.x :: cuda.blockDim.x] = 0


@cuda.jit(cache=True)
def run_cases(
    cases, end, params, field, leds, imu_noise, vision_noise, travel_draws, state, samples, memory,
    poses, frames, delayed, stats, history, arrivals, axes_log, samples_log, sensor_log, codes,
):  # fmt: skip
    """Run the first ``cases`` cases to cycle ``end``; write why each ended, COMPLETED if at ``end``, into ``codes``.

    imu_noise: (n, rows, IMU_NOISE), of the cycles of this launch. vision_noise, travel_draws: of the whole run. leds,
    history, arrivals, axes_log, samples_log, sensor_log: as for ``run_cycles``, shared. codes:
    (n,), COMPLETED at the start. The others: (n, ...) of what ``run_cycles`` takes.
    """
    i = cuda.grid(1)
    if i >= cases or codes[i] != COMPLETED:
        return
    case = state[i]
    transit = case.mock.transit
    exposed = transit.next_exposure - transit.first_exposure
    case.end = end
    codes[i] = run_cycles(
        params[i], field[i], leds, imu_noise[i], vision_noise[i][exposed:], travel_draws[i][exposed:],
        case, samples[i], memory[i], poses[i], frames[i], delayed[i], stats[i],
        history, arrivals, axes_log, samples_log, sensor_log,
    )  # fmt: skip
