"""Backends by their names: entry points of packages, modules, files that change, and their settings."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.config.load import load_scenario
from hil.core.gnc_records import GNC_SETUP
from hil.core.messages import new
from hil.core.settings import Setting
from hil.errors import BadInput
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import backends_of, named
from tests.support.backends import LQR, kernel_file
from tests.support.forks import forked

LAW = "import hil\n\n\nclass Law:\n    settings = (hil.Setting('gain', 2.0, '1/s'),)\n\n    def step(self, inp): ...\n"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Install a package with an entry point for the time of a test; return its name."""
    (tmp_path / "lab_laws").mkdir()
    (tmp_path / "lab_laws" / "__init__.py").write_text(LAW)
    info = tmp_path / "lab_laws-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-laws\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hil.control]\npole = lab_laws:Law\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "lab_laws", raising=False)
    return "lab-laws"


def settings_of(name: str, *more: str) -> dict[str, float]:
    scenario = load_scenario("scheme-1", (f'gnc.control.backend="{name}"', *more))
    return named(scenario, OwnBackends()).value.gnc.control.settings


def test_entry_point_of_a_package_is_found_by_package_and_name(package: str) -> None:
    assert settings_of(f"{package}:pole") == {"gain": 2.0}
    assert settings_of("lab_laws:pole", "gnc.control.settings.gain=3") == {"gain": 3.0}
    assert settings_of("lab_laws:Law") == {"gain": 2.0}  # of the module itself
    with pytest.raises(BadInput, match="known here: gain"):
        settings_of(f"{package}:pole", "gnc.control.settings.pain=3.0")
    with pytest.raises(BadInput, match=r"has no zero: its classes and kernels are Law"):
        settings_of("lab_laws:zero")
    with pytest.raises(BadInput, match=r"those of hil.control are lab-laws:pole"):
        settings_of("lab_lores:pole")


def test_edited_file_is_loaded_again(tmp_path: Path) -> None:
    path = tmp_path / "law.py"
    for value in (2.0, 5.0):
        path.write_text(LAW.replace("2.0", str(value)))
        assert settings_of(f"{path}:Law") == {"gain": value}


def test_edited_kernel_is_compiled_again_and_an_unchanged_one_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_CACHE_DIR", str(tmp_path / "cache"))
    codes = []
    for body in ("out.force[0] = 1", "out.force[0] = -1", "out.force[0] = 1"):
        name = kernel_file(tmp_path, body)
        scenario = load_scenario("scheme-1", (f'gnc.control.backend="{name}"',)).value
        instance = backends_of(scenario)["control"].open(new(GNC_SETUP), np.zeros(0))
        assert instance.step_address
        codes.append(len(list((tmp_path / "cache").rglob("*step-*.nbc"))))
    assert codes == [1, 2, 2]


def test_file_whose_comments_have_changed_is_loaded_by_another_process(tmp_path: Path) -> None:
    name = kernel_file(tmp_path, "out.force[0] = 1")
    path = Path(name.rpartition(":")[0])
    script = (
        "from hil.config.load import load_scenario\nfrom hil.gnc_backends.backend_registry import backends_of\n"
        f"assert backends_of(load_scenario('scheme-1', ('gnc.control.backend=\"{name}\"',)).value)"
    )
    for comment in ("", "# another comment"):
        path.write_text(f"{path.read_text()}{comment}\n")
        done = forked(script, loaded="numba", HIL_CACHE_DIR=str(tmp_path / "cache"))
        assert done.returncode == 0, done.stderr


def test_settings_of_a_backend_are_dropped_when_another_one_takes_its_place() -> None:
    scenario = named(load_scenario("scheme-1", (f'gnc.control.backend="{LQR}"',)), OwnBackends())

    class Law:
        def step(self, inp: object) -> None: ...

    other = named(scenario, OwnBackends(control=Law)).value.gnc.control
    assert (other.backend, other.settings) == ("object:Law", {})
    with pytest.raises(BadInput, match=r"the Python object Law is needed: give it, control=Law"):
        backends_of(scenario.value.model_copy(update={"gnc": scenario.value.gnc.model_copy(update={"control": other})}))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("2nd", 1.0), "'2nd': must be an identifier"),
        (("gain", 3.0, "1", 0.0, 2.0), "gain: default 3, allowed 0 to 2"),
        (("gain", -3.0, "1", 0.0), "default -3, allowed 0 or more"),
    ],
)
def test_declaration_that_contradicts_itself_is_an_error(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Setting(*arguments)  # type: ignore[arg-type]


def test_kernel_can_be_called_as_the_plain_function_that_it_is() -> None:
    @hil.kernel_backend()
    def law(settings: object, inp: object, out: list[int], memory: object) -> None:
        out.append(1)

    found: list[int] = []
    law(None, None, found, None)
    assert found == [1]


def test_object_without_a_step_is_refused() -> None:
    with pytest.raises(BadInput, match=r"int: must be a class or an object with a method step\(inp\)"):
        hil.run("scheme-1", control=3)


def test_backend_together_with_a_whole_gnc_is_refused() -> None:
    class Gnc:
        def step(self, inp: object) -> None: ...

    with pytest.raises(BadInput, match=r"control: another GNC is given: gnc"):
        hil.run("scheme-1", gnc=Gnc(), control=Gnc)
    with pytest.raises(BadInput, match=r'gnc.control.backend: ".*": another GNC is given'):
        hil.run("scheme-1", gnc=Gnc(), overrides={"gnc.control.backend": LQR})
    with pytest.raises(BadInput, match=r'gnc.control.backend: "law.fmu": '):
        hil.run("scheme-1", control="law.fmu")
