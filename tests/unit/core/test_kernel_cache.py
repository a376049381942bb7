"""The cache of compiled kernels: keyed by every source they are compiled from, wherever those are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

import pytest

import hil
from hil.core.jit import KernelCacheFile, kernel, kernel_sources, source_digest

PACKAGE = Path(hil.__file__).parent

CALL_ONE_KERNEL = """
import numpy as np
from hil.maths.limits import cut_to_range
cut_to_range(np.zeros(3), np.zeros(3), np.ones(3), np.empty(3))
print(sum(cut_to_range.stats.cache_hits.values()))
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a copy of the package's sources."""
    return Path(shutil.copytree(PACKAGE, tmp_path / "hil", ignore=shutil.ignore_patterns("__pycache__")))


def run_with_cache(code: str, folder: Path, checkout: Path) -> subprocess.CompletedProcess[str]:
    """Run ``code`` against the package in ``checkout`` with its kernels cached in ``folder``."""
    return run_in(checkout, code, os.environ | {"HIL_CACHE_DIR": str(folder)})


def run_in(checkout: Path, code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run ``code`` against the package in ``checkout``."""
    environment = environment | {"PYTHONPATH": str(checkout)}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, cwd=checkout, capture_output=True, text=True, check=False)


def test_digest_is_the_same_for_a_copy_of_the_sources(copy: Path) -> None:
    assert source_digest(kernel_sources(copy)) == source_digest(kernel_sources(PACKAGE))


def test_kernel_that_moves_to_a_new_folder_stays_in_the_digest(copy: Path) -> None:
    before = source_digest(kernel_sources(copy))
    (copy / "new_folder").mkdir()
    moved = (copy / "dynamics" / "hill.py").rename(copy / "new_folder" / "hill.py")
    assert "new_folder/hill.py" in kernel_sources(copy)
    assert source_digest(kernel_sources(copy)) != before

    after = source_digest(kernel_sources(copy))
    moved.write_bytes(moved.read_bytes().replace(b"2.0 * w0", b"2.1 * w0"))
    assert source_digest(kernel_sources(copy)) != after


@pytest.mark.parametrize("imported", ["core/messages.py", "core/gnc_records.py"])
def test_module_whose_constants_kernels_use_is_in_the_digest(copy: Path, imported: str) -> None:
    before = source_digest(kernel_sources(copy))
    (copy / imported).write_bytes((copy / imported).read_bytes() + b"\nADDED = 1\n")
    assert source_digest(kernel_sources(copy)) != before


def test_module_without_influence_on_kernels_is_not_in_the_digest(copy: Path) -> None:
    before = source_digest(kernel_sources(copy))
    (copy / "cli" / "main.py").write_bytes(b"")
    assert source_digest(kernel_sources(copy)) == before


def test_second_checkout_of_the_same_sources_compiles_nothing(copy: Path, tmp_path: Path) -> None:
    first = run_with_cache(CALL_ONE_KERNEL, tmp_path / "cache", PACKAGE.parent)
    second = run_with_cache(CALL_ONE_KERNEL, tmp_path / "cache", copy.parent)
    assert (first.stdout, second.stdout) == ("0\n", "1\n"), first.stderr + second.stderr


def test_cached_kernel_is_parsed_only_when_another_is_linked_with_it(tmp_path: Path) -> None:
    parsed = f"""{CALL_ONE_KERNEL}
from numba import njit
library, = (result.library for result in cut_to_range.overloads.values())
print(library._shared_module is not None)
@njit
def doubled(x):
    cut_to_range(x, x - 1.0, x + 1.0, x)
    return 2.0 * x[0]
print(doubled(np.full(3, 4.0)))
print(library._shared_module is not None)
"""
    run_with_cache(CALL_ONE_KERNEL, tmp_path, PACKAGE.parent)
    again = run_with_cache(parsed, tmp_path, PACKAGE.parent)
    assert again.stdout.split() == ["1", "False", "8.0", "True"], again.stderr


def test_kernel_is_compiled_again_only_if_a_source_of_its_own_has_changed(copy: Path, tmp_path: Path) -> None:
    prepare_and_call = f"from hil.core.jit import prepare_kernel_cache as prepare; prepare(){CALL_ONE_KERNEL}"

    def hits_after_a_change_of(name: str) -> str:
        with (copy / name).open("a") as file:
            file.write("\n# changed\n")
        done = run_with_cache(prepare_and_call, tmp_path / "cache", copy.parent)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert hits_after_a_change_of("maths/limits.py") == "0\n"
    assert hits_after_a_change_of("dynamics/hill.py") == "1\n"
    assert hits_after_a_change_of("core/jit.py") == "0\n"
    assert hits_after_a_change_of("maths/limits.py") == "0\n"


def test_processes_that_save_signatures_at_once_lose_and_mix_up_none(tmp_path: Path) -> None:
    with get_context("fork").Pool(6) as pool:
        pool.starmap(save_signatures, [(tmp_path, n) for n in range(6)], chunksize=1)
    saved = KernelCacheFile(str(tmp_path), "kernel", "digest")
    keys = [(n, i) for n in range(6) for i in range(40)] + ["shared"]
    assert [saved.load(key) for key in keys] == [f"code of {key}" for key in keys]
    assert len(list(tmp_path.glob("*.nbc"))) == len(keys)


def save_signatures(folder: Path, n: int) -> None:
    """Save 40 signatures of its own and one that every process has."""
    file = KernelCacheFile(str(folder), "kernel", "digest")
    for key in [*((n, i) for i in range(40)), "shared"]:
        file.save(key, f"code of {key}")


def test_code_that_was_removed_is_written_again(tmp_path: Path) -> None:
    file = KernelCacheFile(str(tmp_path), "kernel", "digest")
    file.save("key", "code")
    for code in tmp_path.glob("*.nbc"):
        code.unlink()
    assert file.load("key") is None
    file.save("key", "code")
    assert file.load("key") == "code"


def test_kernel_of_images_is_compiled_once_for_all_integers_that_it_is_called_with() -> None:
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
    assert len(product.signatures) == 1  # type: ignore[attr-defined]


def test_import_writes_nothing(tmp_path: Path) -> None:
    done = run_with_cache("import hil.maths.quat, hil.loop.compiled.loop_kernel", tmp_path / "cache", PACKAGE.parent)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "cache").exists()


def test_kernels_in_a_wheel_are_used_where_they_are(copy: Path, tmp_path: Path) -> None:
    run_with_cache(CALL_ONE_KERNEL, copy, copy.parent)
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("HIL_CACHE_DIR", None)
    done = run_in(copy.parent, CALL_ONE_KERNEL, environment)
    assert done.stdout == "1\n", done.stderr
    assert not (tmp_path / "cache").exists()


def test_kernels_of_another_processor_do_not_count_as_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = "from hil.core.jit import mark_kernels_cached as mark, kernels_are_cached as cached; mark(); print(cached())"
    look = "from hil.core.jit import kernels_are_cached as cached; print(cached())"
    with monkeypatch.context() as other:
        other.setenv("NUMBA_CPU_NAME", "generic")
        assert run_with_cache(mark, tmp_path, PACKAGE.parent).stdout == "True\n"
    assert run_with_cache(look, tmp_path, PACKAGE.parent).stdout == "False\n"


@pytest.mark.parametrize("module", ["hil.fmi.step", "hil.gnc_backends.isolated", "hil.session.build"])
def test_every_start_compiles_for_the_same_processor(module: str) -> None:
    code = f"""
import {module}
from numba.core import config, registry
import hil.core.jit
codegen = registry.cpu_target.target_context.codegen()
print(codegen.magic_tuple()[1:] == (config.CPU_NAME, config.CPU_FEATURES))
"""
    assert run_in(PACKAGE.parent, code, dict(os.environ)).stdout == "True\n"


def test_second_process_leaves_a_group_to_the_first(tmp_path: Path) -> None:
    code = "from hil.core.jit import only_one_process as one\nwith one('loop') as alone: print(alone)"
    nested = f"import subprocess, sys\n{code}; sys.stdout.flush(); subprocess.run([sys.executable, '-c', {code!r}])"
    assert run_with_cache(nested, tmp_path, PACKAGE.parent).stdout == "True\nFalse\n"


def test_cache_that_cannot_be_written_is_one_clear_line() -> None:
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--duration", "1"]
    environment = os.environ | {"HIL_CACHE_DIR": "/proc/hil"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("kernel cache: /proc/hil: cannot be written")
    assert "set HIL_CACHE_DIR" in line
