"""The cache of compiled kernels: keyed by all that they are compiled from, wherever the package is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import pytest
from numba import typeof

import hil
from hil.core import jit
from hil.core.jit import kernel
from tests.support.forks import forked

PACKAGE = Path(hil.__file__).parent

CALL_ONE_KERNEL = """
import numpy as np
from hil.maths.limits import cut_to_range
cut_to_range(np.zeros(3), np.zeros(3), np.ones(3), np.empty(3))
print(sum(cut_to_range._cache_hits.values()))
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a copy of the package's sources."""
    return Path(shutil.copytree(PACKAGE, tmp_path / "hil", ignore=shutil.ignore_patterns("__pycache__")))


def run_with_cache(code: str, folder: Path, checkout: Path) -> subprocess.CompletedProcess[str]:
    """Run ``code`` against the package in ``checkout`` with its kernels cached in ``folder``."""
    return forked(code, checkout, loaded="numba", HIL_CACHE_DIR=str(folder))


def run_fresh(code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a process that has imported nothing before."""
    command, folder = [sys.executable, "-c", code], PACKAGE.parent
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def test_second_checkout_of_the_same_sources_compiles_nothing(copy: Path, tmp_path: Path) -> None:
    first = run_with_cache(CALL_ONE_KERNEL, tmp_path / "cache", PACKAGE.parent)
    second = run_with_cache(CALL_ONE_KERNEL, tmp_path / "cache", copy.parent)
    assert (first.stdout, second.stdout) == ("0\n", "1\n"), first.stderr + second.stderr


def test_kernel_is_compiled_again_only_if_what_it_is_compiled_from_has_changed(copy: Path, tmp_path: Path) -> None:
    def hits_after(file: str, old: str, new: str) -> str:
        text = (copy / file).read_text()
        assert old in text
        (copy / file).write_text(text.replace(old, new))
        done = run_with_cache(CALL_ONE_KERNEL, tmp_path / "cache", copy.parent)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert hits_after("maths/limits.py", "def cut_to_range(", "def cut_to_range(") == "0\n"
    assert hits_after("maths/limits.py", "def cut_to_range(", "# a comment\ndef cut_to_range(") == "1\n"
    assert hits_after("maths/limits.py", "max(", "1.0 * max(") == "0\n"
    assert hits_after("dynamics/hill.py", "2.0 *", "2.1 *") == "1\n"
    assert hits_after("core/jit.py", '"""Compilation', '"""The compilation') == "0\n"
    assert hits_after("maths/limits.py", "1.0 * max(", "max(") == "0\n"


CALL_ONE_ENTRY = """
import numpy as np, numba
from hil.core.messages import AXES, new
from hil.loop.core import LOOP_STATE
from hil.loop.mock_bench import read_axes
read_axes.compile((numba.typeof(new(LOOP_STATE)), numba.float64))
print(sum(read_axes._cache_hits.values()))
"""


def test_one_of_several_processes_compiles_an_entry_and_the_others_wait_for_it(tmp_path: Path) -> None:
    environment = os.environ | {"HIL_CACHE_DIR": str(tmp_path)}
    started = [
        subprocess.Popen([sys.executable, "-c", CALL_ONE_ENTRY], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    assert sorted(process.communicate()[0] for process in started) == ["0\n", "1\n", "1\n"]


def test_caller_of_an_edited_entry_runs_the_new_one_and_is_compiled_again_only_for_another_type(tmp_path: Path) -> None:
    head = "from hil.core.jit import entry\n"
    (tmp_path / "outer.py").write_text(
        f"{head}from inner import part\n@entry\ndef whole(r):\n    return 10.0 * part(r)\n"
    )
    call = """
import numba, numpy as np, sys
for n in range(int(sys.argv[1])):  # numba numbers the layouts of records as it meets them
    numba.typeof(np.zeros(1, [(f"other_{n}", "f8")])[0])
import outer
print(outer.whole(np.ones(1, [("x", "f8"), ("y", "i4")])[0]), sum(outer.whole._cache_hits.values()))
"""
    environment = os.environ | {"HIL_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{PACKAGE.parent}"
    found = []
    for n, body in enumerate(("r.x + 1.5", "r.x + 2.5", "r.y")):
        (tmp_path / "inner.py").write_text(f"{head}@entry\ndef part(r):\n    return {body}\n")
        command = [sys.executable, "-c", call, str(n)]
        found.append(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
    assert found == ["25.0 0\n", "35.0 1\n", "10.0 0\n"]


@pytest.mark.parametrize("mode", [0o777, 0o775])
def test_folder_that_others_may_write_is_refused(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "kernels"
    folder.mkdir()
    folder.chmod(mode)
    line = refusal_of_a_run(tmp_path)
    assert line.startswith(f"kernel cache: {tmp_path}: kernels can be written by other users (mode {mode:o})")
    assert line.endswith("set HIL_CACHE_DIR to a folder of your own")


def test_kernel_that_others_may_write_is_refused_and_not_run(tmp_path: Path) -> None:
    run_with_cache(CALL_ONE_KERNEL, tmp_path, PACKAGE.parent)
    (code,) = (tmp_path / "kernels" / "hil.maths.limits").glob("cut_to_range-*.nbc")
    code.chmod(0o666)
    done = run_with_cache(CALL_ONE_KERNEL, tmp_path, PACKAGE.parent)
    assert done.returncode != 0
    assert "can be written by other users (mode 666), whose code it would run" in done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir()
    os.chown(tmp_path / "kernels", 12345, 12345)
    assert "kernels belongs to another user (uid 12345)" in refusal_of_a_run(tmp_path)


def refusal_of_a_run(cache: Path) -> str:
    """Return the one line with which a run refuses the kernels in ``cache``."""
    run = "from hil.cli.main import main; main(['run', 'scheme-1', '--duration', '1'])"
    done = run_with_cache(run, cache, PACKAGE.parent)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    return line


def test_kernels_that_nothing_has_used_for_months_are_removed(tmp_path: Path) -> None:
    run_with_cache(CALL_ONE_KERNEL, tmp_path, PACKAGE.parent)
    old = tmp_path / "kernels" / "hil.maths.limits" / "gone-0123-4567.nbc"
    old.write_bytes(b"")
    os.utime(old, (0.0, time.time() - 70 * 86_400.0))
    run_with_cache(
        "from hil.core.kernel_folder import remove_unused_kernels as remove; remove()", tmp_path, PACKAGE.parent
    )
    assert not old.exists()
    assert run_with_cache(CALL_ONE_KERNEL, tmp_path, PACKAGE.parent).stdout == "1\n"


def test_kernel_of_images_is_compiled_once_for_all_integers_that_it_is_called_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_CACHE_DIR", str(tmp_path))  # no earlier run left it

    def times(x: float, n: int) -> float:
        return x * n

    times.__module__ = "hil.vmu.kernels.measure"
    product = kernel(times)

    @kernel
    def factorial_of_five(x: float) -> float:
        last = 1
        for n in range(2, 5):
            x = product(x, last)
            last = n
        return product(x, last) * 5.0

    assert factorial_of_five(1.0) == 120.0
    assert len(product.inside().signatures) == 1  # type: ignore[attr-defined]


def test_import_writes_nothing(tmp_path: Path) -> None:
    done = run_with_cache("import hil.maths.quat, hil.loop.compiled.run_cycles", tmp_path / "cache", PACKAGE.parent)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "cache").exists()


def test_kernels_in_a_wheel_are_used_where_they_are(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_with_cache(CALL_ONE_KERNEL, copy, copy.parent)
    monkeypatch.delenv("HIL_CACHE_DIR", raising=False)
    done = forked(CALL_ONE_KERNEL, copy.parent, loaded="numba", XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.stdout == "1\n", done.stderr
    assert not (tmp_path / "cache").exists()


def test_kernels_of_another_processor_do_not_count_as_cached(tmp_path: Path) -> None:
    names = "from hil.session.compiled import mark_kernels_cached as mark, kernels_are_cached as cached"
    other = os.environ | {"NUMBA_CPU_NAME": "generic", "HIL_CACHE_DIR": str(tmp_path)}
    done = run_fresh(f"{names}; mark('cycle'); print(cached('cycle'))", other)
    assert done.stdout == "True\n"
    assert run_with_cache(f"{names}; print(cached('cycle'))", tmp_path, PACKAGE.parent).stdout == "False\n"


@pytest.mark.parametrize("module", ["hil.parts.fmi.step", "hil.session.build"])
def test_every_start_compiles_for_the_same_processor(module: str) -> None:
    code = f"""
import {module}
from numba.core import config, registry
import hil.core.jit
codegen = registry.cpu_target.target_context.codegen()
print(codegen.magic_tuple()[1:] == (config.CPU_NAME, config.CPU_FEATURES))
"""
    assert run_fresh(code, dict(os.environ)).stdout == "True\n"


def test_cache_that_cannot_be_written_is_one_clear_line() -> None:
    line = refusal_of_a_run(Path("/proc/hil"))
    assert line.startswith("kernel cache: /proc/hil: cannot be written")
    assert "set HIL_CACHE_DIR" in line


def test_code_for_a_named_tuple_depends_on_the_names_of_its_fields() -> None:
    one, other = (typeof(namedtuple("Point", names)(1.0, (2.0, 3.0))) for names in ("x y", "y x"))
    assert str(one) == str(other)
    assert jit._fields([one]) != jit._fields([other])
