"""Cases by the CUDA engine in the simulator of numba, which needs a process of its own, and by the CPU.

The simulator runs the kernels as Python. ``run_cycles`` that they call is the compiled one of the CPU, on the simulated
memory of the GPU.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

_SIMULATOR = "NUMBA_ENABLE_CUDASIM"


def run_simulated(scenario: str, settings: Sequence[str], duration_s: float) -> dict[str, Any]:
    """Return rows by GPU and CPU of four cases of a campaign, and the engine's part of the summary.

    Case 1 cannot be drawn on the GPU.
    """
    command = [sys.executable, "-m", "tests.support.cuda_simulator", scenario, str(duration_s), *settings]
    done = subprocess.run(command, env=os.environ | {_SIMULATOR: "1"}, capture_output=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr.decode()
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _main(scenario: str, duration_s: str, *settings: str) -> None:
    from hil.api.jobs import job_of
    from hil.loop.compiled.run_cycles import run_cycles
    from hil.monte_carlo import cuda_engine, cuda_kernel
    from hil.monte_carlo.batch import Case, DrawnCase, run_batch
    from hil.monte_carlo.campaign import RIG, CampaignJob

    def on_memory(*arguments: Any) -> int:
        return int(run_cycles(*(each._item._ary if hasattr(each, "_item") else each for each in arguments)))

    class WithoutCaseOne(Case):
        def load(self, case: int) -> DrawnCase:
            if case == 1:
                raise ValueError("as if it could not be drawn")
            return super().load(case)

    cuda_kernel.run_cycles = on_memory
    cuda_engine._CYCLES = 20  # several launches
    cuda_engine._THREADS = cuda_engine._UPLOADED_AT_ONCE = 1
    cuda_engine._MOST_CASES = 2  # the batch of three in two parts
    cuda_engine.Case = WithoutCaseOne
    spec = CampaignJob.of(job_of(scenario, RIG, tuple(settings), 0, float(duration_s))).spec
    engine = cuda_engine.CudaEngine(1)
    rows = [row for _, batch in engine.run(spec, [(0, 3), (3, 1)]) for row in batch]
    found = {"gpu": rows, "cpu": run_batch(spec, 0, 4), "summary": engine.summary()}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    _main(*sys.argv[1:])
