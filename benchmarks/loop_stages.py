"""Time of each call of the compiled loop in whole runs, in nanoseconds a cycle, and the cost of what can be left out.

    python benchmarks/loop_stages.py [SCENARIO ...] [--set KEY=VALUE ...] [--flights N] [--record]

The stamped loop is ``hil.loop.compiled.run_cycles`` itself, with the processor's time stamp read after each statement
that calls something, so that it cannot differ from the program: the rows of its flight are compared with those of the
loop without time stamps, bit by bit. What the stamps themselves cost is the difference of the two.

Each figure is also given as a ratio to a fixed reference loop of additions, products, divisions and a square root that
depend on one another, timed in turn with the flights: the ratios of two commits on one computer can be compared,
nanoseconds cannot. On idle cores ``--record`` appends the ratios to ``benchmarks/loop_cost.csv`` with the version;
without it the recorded ones are printed with it, and a cycle that costs 3 % more is named. On a virtual machine whose
neighbours are busy a whole run can be 40 % slower: repeat one that is.
"""

from __future__ import annotations

import argparse
import ast
import csv
import inspect
import textwrap
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.loop.compiled import run_cycles as shell
from hil.parts.campaigns.case_runner import CaseRunner

SCENARIOS = ("scheme-1", "tumbling-3")
FLIGHTS = 15
LEDGER = Path(__file__).with_name("loop_cost.csv")
HISTORY = 13  # number of the argument of ``run_cycles``
SLOWER = 1.03
REFERENCE_STEPS = 200_000
_BUDGET = "gnc.navigation.budget."
OPTIONS = {
    "error budget": (
        f"{_BUDGET}vision_bias_sigma_m=[0.0, 0.0, 0.0]", f"{_BUDGET}vision_misalignment_sigma_deg=0.0",
        f"{_BUDGET}vision_scale_sigma=0.0", f"{_BUDGET}vision_noise_scale_sigma=0.0",
    ),
}  # fmt: skip


@intrinsic
def time_stamp(_typing: Any) -> Any:
    """Return the processor's time stamp."""

    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        read = builder.module.declare_intrinsic("llvm.readcyclecounter", (), ir.FunctionType(ir.IntType(64), ()))
        return builder.call(read, ())

    return types.int64(), generate


@njit
def time_stamp_now():
    """Return the time stamp, for Python."""
    return time_stamp()


@njit(error_model="numpy", nogil=True, fastmath=False)
def reference_loop(steps):
    """Return a number after ``steps`` steps, each of which waits for the one before."""
    x = 1.0
    for i in range(steps):
        x = np.sqrt(x * 1.0001 + i / (x + 2.0)) + 0.5
    return x


class _Stamps(ast.NodeTransformer):
    """Puts a time stamp after each statement with a call, in the loop of ``run_cycles``; names the rows."""

    def __init__(self) -> None:
        self.rows: list[str] = []

    def visit_While(self, node: ast.While) -> ast.While:
        node.body = list(self._stamped(node.body))
        return node

    def _stamped(self, statements: list[ast.stmt]) -> Iterator[ast.stmt]:
        for statement in statements:
            calls = _calls(statement.test if isinstance(statement, ast.If) else statement)
            if isinstance(statement, ast.If):
                statement.body = list(self._stamped(statement.body))
            yield statement
            if calls and not isinstance(statement, ast.Return):
                yield from self._stamp(calls[0])

    def _stamp(self, name: str) -> list[ast.stmt]:
        row = str(len(self.rows))
        self.rows.append(name)
        if name == "_run_gnc":
            self.rows[-1:] = [f"{name}, without a pose", f"{name}, with a pose"]
            row = f"{row} + (1 if arrived > 0 else 0)"
        text = f"_now = _stamp()\n_spent[{row}] += _now - _at\n_at = _now"
        return ast.parse(text).body


def _calls(node: ast.AST) -> list[str]:
    """Return the names of what ``node`` calls, outermost first."""
    return [ast.unparse(each.func) for each in ast.walk(node) if isinstance(each, ast.Call)]


def stamped_loop() -> tuple[Callable[..., int], list[str]]:
    """Return ``run_cycles`` with time stamps, which takes the ticks of each row as a last argument, and the rows."""
    source = textwrap.dedent(inspect.getsource(inspect.unwrap(shell.run_cycles.py_func)))
    tree, stamps = ast.parse(source), _Stamps()
    (function,) = (each for each in tree.body if isinstance(each, ast.FunctionDef))
    function.decorator_list, function.name = [], "stamped_cycles"
    function.args.args.append(ast.arg("_spent"))
    function.body[1:1] = ast.parse("_at = _stamp()").body
    names = dict(vars(shell)) | {"_stamp": time_stamp}
    exec(compile(ast.fix_missing_locations(stamps.visit(tree)), "stamped_cycles", "exec"), names)
    return njit(error_model="numpy", nogil=True)(names["stamped_cycles"]), stamps.rows


class Flight(NamedTuple):
    """Costs of a cycle, ns: without stamps, by row with them, and of a step of the reference loop."""

    plain_ns: float
    rows_ns: np.ndarray
    reference_ns: float
    poses: int
    cycles: int
    step_s: float


def fly(name: str, settings: tuple[str, ...], flights: int, loop: Callable[..., int] | None, n_rows: int) -> Flight:
    """Return the least costs of ``flights`` flights of scenario ``name``. loop: of ``stamped_loop``, None: no rows."""
    scenario = load_scenario(name, settings).value
    runner = CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)
    plain, stamped = np.zeros(runner.cycles, CYCLE), np.zeros(runner.cycles, CYCLE)
    plain_s = reference_s = np.inf
    rows_ns = np.full(n_rows, np.inf)
    reference_loop(10)
    for _ in range(flights):
        reference_s = min(reference_s, _seconds(lambda: reference_loop(REFERENCE_STEPS))[0])
        arguments = _prepared(runner, scenario, plain)
        seconds, code = _seconds(lambda arguments=arguments: shell.run_cycles(*arguments))
        assert code == shell.COMPLETED, f"{name} ended with {code}"
        plain_s = min(plain_s, seconds)
        if loop is None:
            continue
        spent, arguments = np.zeros(n_rows, np.int64), _prepared(runner, scenario, stamped)
        first, begun = time_stamp_now(), time.perf_counter()
        assert loop(*arguments, spent) == shell.COMPLETED
        ns_per_tick = (time.perf_counter() - begun) * 1e9 / (time_stamp_now() - first)
        rows_ns = np.minimum(rows_ns, spent * ns_per_tick / runner.cycles)
    if loop is not None:
        assert stamped.tobytes() == plain.tobytes(), "another flight than that of the loop without time stamps"
    poses = int(np.sum(plain["pose"]["fresh"] > 0))
    plain_ns, reference_ns = plain_s / runner.cycles * 1e9, reference_s / REFERENCE_STEPS * 1e9
    return Flight(plain_ns, rows_ns, reference_ns, poses, runner.cycles, scenario.step_s)


def _prepared(runner: CaseRunner, scenario: Any, history: np.ndarray) -> list[Any]:
    arguments = list(runner.prepared(scenario, 0))
    arguments[0].counts, arguments[HISTORY] = 1, history
    return arguments


def _seconds(call: Callable[[], int]) -> tuple[float, int]:
    begun = time.thread_time()
    result = call()
    return time.thread_time() - begun, result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS)
    parser.add_argument("--set", action="append", default=[], dest="settings")
    parser.add_argument("--flights", type=int, default=FLIGHTS)
    parser.add_argument("--record", action="store_true")
    options = parser.parse_args()
    loop, rows = stamped_loop()
    recorded, slower = _recorded(), []
    for name in options.scenarios:
        flight = fly(name, tuple(options.settings), options.flights, loop, len(rows))
        ratio = flight.plain_ns / flight.reference_ns
        before = recorded.get(name)
        print(f"{name}: {flight.poses} of {flight.cycles} cycles fuse a pose")
        for row, ns in zip(rows, flight.rows_ns, strict=True):
            if ns >= 0.5:
                print(f"  {row:44s} {ns:8.0f} ns {ns / flight.reference_ns:9.1f}")
        print(f"  {'sum of the calls':44s} {flight.rows_ns.sum():8.0f} ns")
        speed = f"{flight.step_s / flight.plain_ns * 1e9:.0f} x real time"
        print(f"  {'a cycle without time stamps':44s} {flight.plain_ns:8.0f} ns {ratio:9.1f}, {speed}")
        print(f"  {'a step of the reference loop':44s} {flight.reference_ns:8.1f} ns       1.0")
        if not options.settings:
            _options(name, options.flights)
            if before is not None:
                print(f"  {'recorded last':44s} {'':8s}    {before:9.1f}, now {ratio / before:.3f} of it")
                slower += [name] if ratio > SLOWER * before else []
            if options.record:
                _record(name, ratio)
    if slower:
        print(f"slower than recorded by more than {SLOWER - 1:.0%}: {', '.join(slower)}")
    return 1 if slower and not options.record else 0


def _options(name: str, flights: int) -> None:
    """Print what each block costs that a scenario can leave out: with and without it fly in turn."""
    for option, settings in OPTIONS.items():
        costs = [[fly(name, each, 1, None, 0).plain_ns for each in ((), settings)] for _ in range(flights)]
        whole, without = np.min(costs, axis=0)
        print(f"  {option:44s} {whole - without:8.0f} ns")


def _recorded() -> dict[str, float]:
    """Return the last recorded ratio of each scenario."""
    if not LEDGER.exists():
        return {}
    with LEDGER.open(newline="") as file:
        return {row["scenario"]: float(row["ratio"]) for row in csv.DictReader(file)}


def _record(name: str, ratio: float) -> None:
    new = not LEDGER.exists()
    with LEDGER.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(["version", "scenario", "ratio"])
        writer.writerow([metadata.version("hil-bench"), name, f"{ratio:.1f}"])


if __name__ == "__main__":
    raise SystemExit(main())
