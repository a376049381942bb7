"""What hil overrides in numba's compiler, one test for each: its failure names the version of numba that changes it.

Written for numba 0.63 to 0.68.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.codegen import JITCPUCodegen

from hil.core.jit import kernel
from hil.core.kernel_library import EntryLibrary, InlineLibrary, _KernelLibrary, whole_module
from tests.support.forks import forked

_THIS = f"numba {numba.__version__}"


@kernel
def _third(x: float) -> float:
    return x / 3.0


@kernel
def _ninth(x: float) -> float:
    return _third(_third(x))


@pytest.fixture(scope="module")
def ninth(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a kernel that was called from Python, and compiled for it by this process: no earlier run left it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HIL_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        assert _ninth(1.0) == 1.0 / 3.0 / 3.0
    return _ninth


def library_of(compiled: Any) -> Any:
    """Return the only library of a kernel."""
    (result,) = compiled.overloads.values()
    return result.library


def test_code_generator_makes_libraries_of_this_class() -> None:
    assert JITCPUCodegen._library_class is _KernelLibrary, _THIS


def test_kernel_that_another_calls_is_bitcode_without_machine_code(ninth: Any) -> None:
    inside: Any = _third
    library = library_of(inside.inside())
    assert isinstance(library, InlineLibrary), _THIS
    assert library.get_pointer_to_function(library.name) == 0, _THIS
    assert not inside.overloads, f"{_THIS}: compiled for Python, which never calls it"
    assert isinstance(library_of(ninth), EntryLibrary), _THIS


def test_entry_holds_the_inlined_kernels_and_no_others(ninth: Any) -> None:
    functions = [f.name for f in library_of(ninth)._get_module_for_linking().functions]
    assert not any("_third" in name for name in functions), f"{_THIS}: not inlined, or left behind"


def test_references_are_counted_where_arrays_are_made_and_not_in_the_loop() -> None:
    from hil.maths import quat

    for made, function in ((False, quat.normalise), (True, quat.to_matrix)):
        compiled: Any = function
        array = compiled(np.array([0.0, 0.0, 0.6, 0.8]))
        code = str(library_of(compiled)._get_module_for_linking())
        assert ("NRT_MemInfo_alloc" in code, "NRT_decref" in code) == (made, made), _THIS
        assert (array is not None) == made


def test_array_that_a_kernel_makes_lives_as_long_as_it_is_used() -> None:
    from hil.maths import quat

    turn, many = np.array([0.0, 0.0, 0.6, 0.8]), []
    first = quat.to_matrix(turn)
    for _ in range(1000):
        many.append(quat.multiply(turn, quat.conjugate(turn)))
        quat.normalise(turn)
    np.testing.assert_array_equal(quat.to_matrix(turn), first)
    np.testing.assert_allclose(many, [[0.0, 0.0, 0.0, 1.0]] * len(many), atol=1e-15)
    assert {sys.getrefcount(array) for array in many} == {3}, f"{_THIS}: a reference too many, or too few"


def test_names_in_the_code_do_not_depend_on_the_order_of_compilation() -> None:
    code = """
import numpy as np
from hil.maths import limits, quat
if {0}:
    quat.normalise(np.ones(4))
limits.cut_to_range(np.zeros(3), np.zeros(3), np.ones(3), np.empty(3))
(result,) = limits.cut_to_range.overloads.values()
print(result.fndesc.mangled_name)
"""
    names = [forked(code.format(after), loaded="numba").stdout for after in (False, True)]
    assert names[0] == names[1] != "", _THIS


def test_types_of_records_are_made_by_this_program_once() -> None:
    from hil.core import jit

    layout = np.dtype([("inner", [("a", "f8")]), ("b", "i4")])
    numba.typeof(np.zeros(2, layout))
    assert jit._records[id(layout)][0] is layout, _THIS
    assert id(layout["inner"]) in jit._records, f"{_THIS}: made without the function that keeps them"


def test_module_of_an_entry_with_all_that_it_calls_lacks_no_kernel() -> None:
    from hil.core.messages import new
    from hil.loop.compiled.run_cycles import _send_setpoint
    from hil.loop.core import LOOP_PARAMS, LOOP_STATE

    sends: Any = _send_setpoint
    sends.compile((*(numba.typeof(new(layout)) for layout in (LOOP_PARAMS, LOOP_STATE)), numba.float64))
    module = whole_module(library_of(sends))
    missing = [f.name for f in module.functions if f.is_declaration and "hil" in f.name]
    assert missing == [], _THIS


def test_kernels_from_the_cache_do_not_import_blas_and_a_kernel_that_needs_it_does() -> None:
    code = """
import sys, numpy as np
from hil.core.jit import kernel
from hil.maths.quat import normalise

@kernel
def product(a, b):
    return np.dot(a, b)

normalise(np.ones(4))
print("scipy.linalg" in sys.modules, product(np.ones(3), np.ones(3)), "scipy.linalg" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "False 3.0 True\n", f"{_THIS}: {done.stderr}"
