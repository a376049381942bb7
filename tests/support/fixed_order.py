"""Search for arithmetic whose last bits depend on the computer, in the code that determines a run.

Not allowed there: functions of the C library, in ``math`` or numpy; powers, which Python and numpy leave to it;
products of matrices and ``np.linalg``, which are BLAS and LAPACK; scipy. ``hil.maths`` has the same in a fixed order.
The text does not show Python's ``sum`` of floats, compensated from 3.12 on, for which there is ``linear.total``.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent.parent / "hil"
EXEMPT: Final = {
    "parts/commissioning": "fits with stated uncertainties",
    "checks/observability.py": "an analysis of the sensors before a run, shown to two digits",
    "vmu": "measurements from pictures",
    "parts/monitor": "measurements from pictures",
    "parts/cameras": "pictures",
    "parts/console": "display",
    "parts/links/gnc_check": "tests of another's GNC, with tolerances",
    "preflight": "measurements of the host",
    "parts/campaigns/pytest_plugin": "display",
    "gnc/estimation/shadow_filter.py": "the independent filter of filterpy",
    "parts/geometry": "fits with stated uncertainties",
    "parts/fmi/units.py": "powers of units, which are whole",
    "maths/order_statistics.py": "statistics of the rows of a campaign",
    "parts/campaigns/drivers.py": "regressions on the rows of a campaign",
    "parts/campaigns/explain.py": "statistics of the rows of a campaign",
    "parts/campaigns/figure.py": "display",
    "parts/campaigns/fusion.py": "the study of the filters alone",
    "parts/campaigns/fusion_interval.py": "the study of the filters alone",
    "parts/campaigns/fusion_kernel.py": "the study of the filters alone",
    "parts/campaigns/margins.py": "statistics of the rows of a campaign",
    "parts/campaigns/statistics.py": "statistics of the rows of a campaign",
    "parts/campaigns/sobol_indices.py": "statistics of the rows of a campaign",
    "drivers/vmu/frame_codec.py": "Euler angles that emulators send",
    "recording/foxglove.py": "display",
    "recording/foxglove_scene.py": "display",
    "parts/export/ros2.py": "export",
    "parts/vision/view_plan.py": "a plan of views with stated uncertainties",
    "parts/wires/devices.py": "measurements of the host",
    "recording/catalogue.py": "display",
    "report/authority_figure.py": "display",
    "report/comparison.py": "statistics of two runs",
    "report/figures.py": "display",
    "report/latency.py": "fits with stated uncertainties",
    "sensors/check.py": "tests of a sensor's module, with tolerances",
}
"""Packages and files whose numbers are in no row, verdict or record of a run, and why they may differ; so are those of
the command line."""

_FUNCTIONS: Final = """
    sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp exp2 expm1 log log2 log10 log1p pow cbrt hypot
    dist erf erfc gamma lgamma arcsin arccos arctan arctan2 power float_power logaddexp cov corrcoef
    dot vdot inner matmul tensordot einsum convolve correlate linalg trapezoid
"""
_NAMES: Final = frozenset(_FUNCTIONS.split())
_KERNELS: Final = frozenset({"kernel", "entry"})
_DRAWS: Final = frozenset({"normal", "exponential"})


def places() -> Iterator[str]:
    """Yield each place of such arithmetic: file, line and what it is."""
    for path in sorted(ROOT.rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if {"cli", "cli.py"} & {*name.split("/")} or any(f"{name}/".startswith(f"{exempt}/") for exempt in EXEMPT):
            continue
        for line, what in faults_of(ast.parse(path.read_text(encoding="utf-8")), path.parent.name == "sensors"):
            yield f"hil/{name}:{line}: {what}"


def faults_of(node: ast.AST, in_kernel: bool = False) -> Iterator[tuple[int, str]]:
    """Yield line and kind of each such operation in ``node``."""
    if isinstance(node, ast.FunctionDef):
        in_kernel = in_kernel or any(isinstance(d, ast.Name) and d.id in _KERNELS for d in node.decorator_list)
    if (what := _fault(node, in_kernel)) is not None:
        yield getattr(node, "lineno", 0), what
    for child in ast.iter_child_nodes(node):
        yield from faults_of(child, in_kernel)


def _fault(node: ast.AST, in_kernel: bool) -> str | None:
    match node:
        case ast.Attribute(value=ast.Name(id="math" | "np"), attr=name) if name in _NAMES:
            return name
        case ast.Call(func=ast.Attribute(attr=name)) if name in _DRAWS:
            return name
        case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
            return "@"
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent) if not _is_exact(base, exponent, in_kernel):
            return "**"
        case ast.ImportFrom(module=str(module)) if module.startswith("scipy."):
            return f"import of {module}"
    return None


def _is_exact(base: ast.expr, exponent: ast.expr, in_kernel: bool) -> bool:
    """Return whether a power is a product: of whole numbers, or a small one in a kernel."""
    if isinstance(base, ast.Constant) and isinstance(base.value, int):
        return not (isinstance(exponent, ast.UnaryOp) or isinstance(getattr(exponent, "value", 0), float))
    return in_kernel and isinstance(exponent, ast.Constant) and isinstance(exponent.value, int)
