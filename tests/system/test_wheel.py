"""The wheel, installed outside the checkout: it has its files, names its build and runs a scheme."""

from __future__ import annotations

import json
import os
import platform
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib.metadata import version as version_of
from pathlib import Path

import pytest

import hil
from hil.core.build_info import VERSION, build_info

ROOT = Path(hil.__file__).parents[1]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")


def run(*command: str | Path, **options: object) -> str:
    """Return the output of a command that must succeed; this checkout is not on its path."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | options.pop("env", {})  # type: ignore[operator]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel, built from this checkout without network."""
    folder = tmp_path_factory.mktemp("wheel")
    build = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder, ROOT)
    run(*PIP, *build, env={"PYTHONPATH": os.environ.get("PYTHONPATH", "")})
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the programs of a virtual environment with the wheel and the dependencies of this one."""
    folder = tmp_path_factory.mktemp("bare")
    run(sys.executable, "-m", "venv", "--without-pip", folder)
    run(*PIP, "--python", folder / "bin" / "python", "install", "--quiet", "--no-deps", "--no-index", wheel)
    (packages,) = folder.glob("lib/python*/site-packages")
    paths = {sysconfig.get_paths()[name] for name in ("purelib", "platlib")}
    (packages / "dependencies.pth").write_text("\n".join(paths))
    return folder / "bin"


def test_wheel_has_configs_page_header_and_types(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = {p.relative_to(ROOT).as_posix() for p in (ROOT / "hil").rglob("*") if p.is_file()}
    sources = {name for name in sources if "__pycache__" not in name and not name.startswith("hil/kernels/")}
    assert sources <= names  # kernels of an earlier "make wheel" are not sources
    assert {f"hil/{p.relative_to(ROOT).as_posix()}" for p in (ROOT / "configs").rglob("*.toml")} <= names
    assert {"hil/py.typed", "hil/core/commit.txt"} <= names
    assert any(name.startswith("hil/parts/console/page/") for name in names)


def test_wheel_without_kernels_is_pure_and_has_the_files_of_hil_init(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert wheel.name.endswith("-py3-none-any.whl")
    assert not any(name.startswith("hil/kernels/") for name in names)
    assert {f"hil/configs/{name}" for name in ("lab/dot_gitlab-ci.yml", "backends/lqr.py")} <= names


def test_wheel_with_kernels_has_the_tags_of_python_and_processor(tmp_path: Path) -> None:
    for path in ("hil", "configs", "examples", "docs"):
        shutil.copytree(
            ROOT / path, tmp_path / path, ignore=shutil.ignore_patterns("__pycache__", "kernels", "pictures")
        )
    for path in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / path, tmp_path / path)
    (tmp_path / "hil" / "vmu" / "kernels").mkdir()
    shutil.copytree(ROOT / "hil" / "vmu" / "kernels", tmp_path / "hil" / "vmu" / "kernels", dirs_exist_ok=True)
    build = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", tmp_path / "dist")
    environment = {"HIL_WHEEL_KERNELS": "1"}
    with pytest.raises(AssertionError, match="holds no kernels"):
        run(*PIP, *build, tmp_path, env=environment)
    (tmp_path / "hil" / "kernels").mkdir()
    (tmp_path / "hil" / "kernels" / "of_a_test").write_bytes(b"code")
    run(*PIP, *build, tmp_path, env=environment)
    (found,) = (tmp_path / "dist").glob("*.whl")
    version = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert found.name.endswith(
        f"-{version}-{version}-manylinux_2_28_{platform.machine()}.whl"
    )  # an index takes no other
    archive = zipfile.ZipFile(found)
    assert "hil/kernels/of_a_test" in archive.namelist()
    required = metadata_of(archive).get_all("Requires-Dist")
    assert {f"{name}=={version_of(name)}" for name in ("numba", "llvmlite", "numpy")} <= set(required)


def metadata_of(archive: zipfile.ZipFile) -> Message:
    """Return the metadata of a wheel."""
    (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
    return message_from_bytes(archive.read(name))


def test_wheel_has_documentation_and_what_an_index_shows(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    assert "hil/" + "docs/how-to/fly-a-law.md" in archive.namelist()
    shown = metadata_of(archive)
    assert shown["Author"] == "hil-bench contributors"
    assert "docking" in shown["Keywords"]
    text = str(shown.get_payload())
    assert text.startswith("# hil-bench")
    assert re.findall(r"\]\((?!https?:)", text) == []
    (points,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
    assert "hil-bench = hil.cli.main:main" in archive.read(points).decode()


def test_links_of_the_description_are_completed_by_the_address_of_the_project() -> None:
    described = runpy.run_path(str(ROOT / "hatch_build.py"))["described"]
    text = "![plan](pictures/a.png) and [page](pages/b.md#c), [site](https://x.org)"
    assert described(text, "") == " and page, [site](https://x.org)"
    assert described(text, "https://x.org/blob/f/") == (
        "![plan](https://x.org/raw/f/pictures/a.png) and [page](https://x.org/blob/f/pages/b.md#c), [site](https://x.org)"
    )


@pytest.mark.slow
def test_installed_package_runs_scheme_1_and_names_its_build(bare: Path, tmp_path: Path) -> None:
    code = "import hil, pathlib; print(pathlib.Path(hil.__file__).parents[1])"
    assert run(bare / "python", "-c", code, cwd=tmp_path).strip() == str(bare.parent / next_packages(bare))
    found = json.loads(run(bare / "hil", "run", "scheme-1", "--json", "-", "--record", "runs", cwd=tmp_path))
    assert found["passed"]
    assert found["build"] == {"version": VERSION, "commit": build_info().commit}
    code = "import hil, sys; print(hil.open(sys.argv[1]).recorded.run['hil_commit'])"
    file = found["recording"]["file"]
    assert run(bare / "python", "-c", code, file, cwd=tmp_path).strip() == build_info().commit
    run(bare / "hil", "report", file, "-o", "report.html", cwd=tmp_path)
    assert build_info().commit in (tmp_path / "report.html").read_text()


def next_packages(bare: Path) -> str:
    """Return the path of the environment's packages in it."""
    (found,) = bare.parent.glob("lib/python*/site-packages")
    return found.relative_to(bare.parent).as_posix()
