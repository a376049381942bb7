"""Engine that runs the cases on a CUDA GPU, as many at once as its memory takes.

The CPU draws each case and its noise from the generators of the other engines, and computes the row from the RUN_STATS
that come back. A GPU rounds some functions differently: the first cases are run on the CPU as well, and the campaign
stops if an outcome differs by more than the bound.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import math
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

import numpy as np
from numba.core import config as numba_config

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.dynamics.imu import IMU_NOISE
from hil.errors import BadInput, CampaignStopped, one_line
from hil.loop.compiled.run_cycles import COMPLETED, run_cycles
from hil.maths.random_streams import NoiseSource, noise_source
from hil.monte_carlo.batch import Batch, Case, DrawnCase, Rows, Spec, not_flown, worker_count
from hil.monte_carlo.outcome import NUMERIC, TEXTS
from hil.params.sensors import sensors_of

_THREADS: Final = 64  # per block
_CYCLES: Final = 500  # of a launch, unless the run is shorter
_UPLOADED_AT_ONCE: Final = 128
_MOST_CASES: Final = 1 << 16  # at once
_MEMORY_FRACTION: Final = 0.9
_COMPARED: Final = 4
BOUND: Final = 1e-6
"""Largest difference from the CPU, relative to the number, or absolute below 1."""

_NAMES: Final = tuple(inspect.signature(run_cycles).parameters)
"""Names of the arguments of ``run_cycles``."""
_UPLOADED: Final = ("params", "field", "vision_noise", "travel_draws", "state", "samples", "stats")
"""Arguments that are copied to the GPU for each case."""
_BY_CASE: Final = (*_UPLOADED, "memory", "imu_noise", "poses", "frames", "delayed", "codes")
"""Arrays on the GPU with a leading axis of cases."""
_REASON: Final = 300  # characters
_NOT_FLOWN: Final = -1
_NO_NOISE: Final = np.zeros((0, IMU_NOISE))


def _is_installed() -> bool:
    """Return whether numba-cuda is installed, or its simulator chosen, which numba has as well."""
    settings: Any = numba_config
    return bool(settings.ENABLE_CUDASIM) or importlib.util.find_spec("numba_cuda") is not None


def cuda_of_numba() -> Any:
    """Return numba.cuda. Raises BadInput without a GPU that it can use."""
    if not _is_installed():
        text = "cuda: needs numba-cuda, which is not installed: pip install 'hil-bench[cuda]'"
        raise BadInput.single("--engine", "", text)
    cuda = importlib.import_module("numba.cuda")
    if not cuda.is_available():
        reason = one_line(str(cuda.cuda_error() or "no device"), 200)
        raise BadInput.single("--engine", "", f"cuda: no GPU that can be used: {reason}")
    return cuda


class CudaEngine:
    """A CUDA GPU. Raises BadInput without one, or if one of ``scenarios`` has an external GNC.

    threads: of the CPU, that draw the noise; 0: one per core.
    """

    def __init__(self, threads: int, scenarios: Sequence[Loaded[Scenario]] = ()) -> None:
        for each in scenarios:
            if each.value.gnc.binary is not None or each.value.gnc.foreign:
                raise BadInput.single(each.where("gnc"), "gnc", "an external GNC does not run on a GPU: --engine cpu")
            if sensors := sensors_of(each.value):
                text = f"{', '.join(sensors)}: modules of sensors do not run on a GPU: --engine cpu"
                raise BadInput.single(each.where("sensors"), "sensors", text)
        self._cuda = cuda_of_numba()
        self.workers = worker_count(threads)
        self._agreement: dict[str, Any] = {}

    def run(self, spec: Spec, batches: Iterable[Batch]) -> Generator[tuple[int, Rows], None, None]:
        """Yield first case and rows of each batch."""
        left = list(batches)
        if not left:
            return
        case = Case(spec)
        with _gpu_errors(), ThreadPoolExecutor(self.workers) as threads:
            gpu = _Gpu(self._cuda, case, threads, sum(count for _, count in left))
            for group in _groups(left, gpu.capacity):
                rows = gpu.run([number for first, count in group for number in range(first, first + count)])
                if group[0] == left[0]:
                    self._agreement = compare_rows(rows, [case.row(row["case"]) for row in rows[:_COMPARED]])
                taken = 0
                for first, count in group:
                    yield first, rows[taken : taken + count]
                    taken += count

    def summary(self) -> dict[str, Any]:
        """Return the part of a campaign's summary about the engine."""
        name = getattr(self._cuda.current_context().device, "name", "simulator of numba")
        device = name.decode() if isinstance(name, bytes) else name
        return {"engine": {"name": "cuda", "device": device, "agreement": self._agreement}}

    def close(self) -> None:
        """Do nothing: the memory of the GPU is released with the last use of its arrays."""


def _groups(batches: Sequence[Batch], capacity: int) -> Iterator[list[Batch]]:
    """Yield the batches in groups of at most ``capacity`` cases, or of one batch."""
    group: list[Batch] = []
    for batch in batches:
        if group and sum(count for _, count in group) + batch[1] > capacity:
            yield group
            group = []
        group.append(batch)
    yield group


@contextmanager
def _gpu_errors() -> Iterator[None]:
    """Raise CampaignStopped for an error of the GPU, its driver or its compiler."""
    try:
        yield
    except Exception as error:
        if not type(error).__module__.startswith(("numba.cuda", "cuda.")):
            raise
        reason = one_line(str(error) or type(error).__name__, _REASON)
        raise CampaignStopped(f"GPU: {reason}: completed cases are kept, run the command again") from error


def compare_rows(found: Rows, expected: Rows) -> dict[str, Any]:
    """Return the largest difference of the first rows from ``expected``, those of the CPU; raise CampaignStopped.

    It is relative to the number, or absolute below 1. Above BOUND, or if a text differs, the campaign stops.
    """
    largest, outcome = 0.0, ""
    for row, reference in zip(found, expected, strict=False):
        for name in (*TEXTS, *NUMERIC):
            difference = _difference(row[name], reference[name])
            if not difference <= BOUND:
                text = f"case {row['case']}: {name} is {row[name]} on the GPU and {reference[name]} on the CPU"
                raise CampaignStopped(f"{text}: more than {BOUND:g} apart, nothing of the GPU is kept")
            if difference > largest:
                largest, outcome = difference, name
    return {"cases": len(expected), "largest_difference": largest, "outcome": outcome, "bound": BOUND}


def _difference(found: Any, expected: Any) -> float:
    if isinstance(expected, str) or found is None or expected is None:
        return 0.0 if found == expected else math.inf
    return abs(float(found) - float(expected)) / max(1.0, abs(float(expected)))


class _Flown(NamedTuple):
    """A case that the GPU runs: as drawn, and the source of its IMU's noise."""

    drawn: DrawnCase
    imu: NoiseSource


class _Gpu:
    """Memory of ``capacity`` cases on the GPU, at most ``cases``, and the kernels."""

    def __init__(self, cuda: Any, case: Case, threads: ThreadPoolExecutor, cases: int) -> None:
        from hil.monte_carlo import cuda_kernel

        self._cuda, self._kernels, self._case, self._threads = cuda, cuda_kernel, case, threads
        self._cycles, self._samples = case.runner.cycles, case.runner.scenario.imu_samples
        self._rows = min(self._cycles, _CYCLES) * self._samples
        scenario = case.runner.scenario
        case.runner.load(scenario, 0)
        self._example = self._arguments(scenario, 0)
        self._bytes = sum(self._shape_of(name)[1].itemsize * math.prod(self._shape_of(name)[0]) for name in _BY_CASE)
        self._allocate(1)
        self._launch(0, 0)  # compiles the kernels, and takes the memory of their stacks
        free = cuda.current_context().get_memory_info().free
        self.capacity = int(min(cases, _MOST_CASES, max(1.0, _MEMORY_FRACTION * free / self._bytes)))
        self._allocate(self.capacity)

    def _arguments(self, truth: Scenario, seed: int) -> dict[str, Any]:
        """Return the arguments of ``run_cycles`` of the case that is loaded, by name, without the IMU's noise."""
        return dict(zip(_NAMES, self._case.runner.arguments(truth, seed, _NO_NOISE), strict=True))

    def _shape_of(self, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        if name == "imu_noise":
            return (self._rows, IMU_NOISE), np.dtype(float)
        if name == "codes":
            return (), np.dtype(np.int64)
        return self._example[name].shape, np.dtype(self._example[name].dtype)

    def _allocate(self, cases: int) -> None:
        """Allocate memory on the GPU for ``cases`` cases, and on the CPU for what is copied."""
        self._on_gpu: dict[str, Any] = {}
        for name in _BY_CASE:
            shape, dtype = self._shape_of(name)
            self._on_gpu[name] = self._cuda.device_array((cases, *shape), dtype)
        for name in ("leds", "history", "arrivals", "axes_log", "samples_log", "sensor_log"):
            self._on_gpu[name] = self._cuda.to_device(np.ascontiguousarray(self._example[name]))
        self._uploaded: dict[str, np.ndarray] = {}
        for name in _UPLOADED:
            shape, dtype = self._shape_of(name)
            self._uploaded[name] = np.empty((min(cases, _UPLOADED_AT_ONCE), *shape), dtype)
        self._noise = np.empty((cases, self._rows, IMU_NOISE))

    def run(self, cases: Sequence[int]) -> Rows:
        """Return the rows of ``cases``."""
        rows: Rows = []
        for at in range(0, len(cases), self.capacity):
            rows += self._run(cases[at : at + self.capacity])
        return rows

    def _run(self, cases: Sequence[int]) -> Rows:
        """Return the rows of ``cases``, at most ``capacity``."""
        begun = [found for at in range(0, len(cases), _UPLOADED_AT_ONCE) for found in self._upload(cases, at)]
        codes = np.array([COMPLETED if isinstance(found, _Flown) else _NOT_FLOWN for found in begun])
        self._on_gpu["codes"][: len(cases)].copy_to_device(codes)
        sources = [(i, found.imu) for i, found in enumerate(begun) if isinstance(found, _Flown)]
        end = 0
        while end < self._cycles:
            n = min(_CYCLES, self._cycles - end)
            self._draw(sources, n * self._samples)  # while the GPU runs the launch before
            self._on_gpu["imu_noise"][: len(cases)].copy_to_device(self._noise[: len(cases)])
            end += n
            self._launch(len(cases), end)
        codes = self._on_gpu["codes"][: len(cases)].copy_to_host()
        stats = self._on_gpu["stats"][: len(cases)].copy_to_host()
        return [self._row(i, found, int(codes[i]), stats[i]) for i, found in enumerate(begun)]

    def _upload(self, cases: Sequence[int], at: int) -> list[_Flown | dict[str, Any]]:
        """Copy the next cases from ``cases[at]`` on to the GPU; return each, or the row of one that cannot be flown."""
        chosen = cases[at : at + _UPLOADED_AT_ONCE]
        begun: list[_Flown | dict[str, Any]] = []
        for i, number in enumerate(chosen):
            try:
                begun.append(self._load(i, number))
            except Exception as error:  # one case must not end the campaign: its row has the reason
                begun.append(self._case.complete(number, not_flown(error)))
        for name, values in self._uploaded.items():
            self._on_gpu[name][at : at + len(chosen)].copy_to_device(values[: len(chosen)])
        memory = self._on_gpu["memory"][at : at + len(chosen)]
        self._kernels.clear_words[len(chosen), _THREADS](memory.view(np.uint64))
        return begun

    def _load(self, i: int, number: int) -> _Flown | dict[str, Any]:
        """Write the arguments of a case as number ``i`` of the next copy; return it, or its row if not flown."""
        drawn, runner = self._case.load(number), self._case.runner
        if interlock := runner.load(drawn.truth, drawn.seed):
            return self._case.complete(number, self._case.outcome(drawn, runner.stats, interlock))
        arguments = self._arguments(drawn.truth, drawn.seed)
        for name, values in self._uploaded.items():
            values[i] = arguments[name]
        return _Flown(drawn, noise_source(drawn.seed, "imu"))

    def _draw(self, sources: Sequence[tuple[int, NoiseSource]], rows: int) -> None:
        """Draw the noise of the IMU of the next launch, ``rows`` rows per case."""

        def draw(source: tuple[int, NoiseSource]) -> None:
            source[1].standard_normal(out=self._noise[source[0], :rows])

        for _ in self._threads.map(draw, sources):
            pass

    def _launch(self, cases: int, end: int) -> None:
        """Start the run of the first ``cases`` cases to cycle ``end``."""
        on_gpu = self._on_gpu
        arguments = [on_gpu[name] for name in _NAMES]
        blocks = max(1, math.ceil(cases / _THREADS))
        self._kernels.run_cases[blocks, _THREADS](cases, end, *arguments, on_gpu["codes"])

    def _row(self, i: int, begun: _Flown | dict[str, Any], code: int, stats: np.record) -> dict[str, Any]:
        """Return the row of a case that ended with ``code``."""
        if not isinstance(begun, _Flown):
            return begun
        drawn, runner = begun.drawn, self._case.runner
        state = self._example["state"]
        if code != COMPLETED:
            state = self._on_gpu["state"][i : i + 1].copy_to_host()[0]
        return self._case.complete(drawn.case, self._case.outcome(drawn, *runner.outcome(code, stats, state)))
