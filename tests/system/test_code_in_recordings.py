"""Recordings are data: code that they name is not loaded, unless the user trusts it or names it as well."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hil.cli.main import BAD_INPUT, FAILED, PASSED
from hil.core import own_code
from hil.core.own_code import note_data, note_users, require_trust
from hil.errors import BadInput
from hil.gnc_backends.backend_registry import backend_file
from tests.support.example_driver import EXAMPLES
from tests.support.external_gnc import c_example, compile_c
from tests.support.fmu import example_fmu
from tests.support.forks import hil

MARK = '__import__("pathlib").Path({!r}).touch()\n'
C_MARK = '#include <stdio.h>\n__attribute__((constructor)) static void mark(void) {{ fclose(fopen("{}", "w")); }}\n'
FORMS = ("controller.py", "sensor.py", "whole.so", "whole", "part.so", "gnc.fmu", "isolated.fmu")


def settings_of(form: str, folder: Path, ran: Path) -> list[str]:
    """Return settings that name code in ``folder`` which touches ``ran`` when it is loaded."""
    if form == "controller.py":
        path = folder / form
        path.write_text((EXAMPLES / "backends" / "controller.py").read_text() + MARK.format(str(ran)))
        return [f'gnc.control.backend="{path}:DeadBand"']
    if form == "sensor.py":
        path = folder / form
        path.write_text((EXAMPLES / "sensor_python" / "acme_bearing.py").read_text() + MARK.format(str(ran)))
        return [f'sensors.bearing.kind="{path}:BearingCamera"']
    mark = C_MARK.format(ran)
    if form in ("whole.so", "whole"):
        return [f"gnc.library={c_example(folder, form, f'{FIRST} => {mark}{FIRST}')}"]
    if form == "part.so":
        source = folder / "observer.c"
        source.write_text(mark + (EXAMPLES / "backends" / "observer.c").read_text())
        return [f'gnc.navigation.backend="{compile_c([source], folder / form, "-fPIC", "-shared", "-w")}"']
    made = example_fmu(folder, 2, f"{FIRST} => {mark}{FIRST}")
    return [f"gnc.fmu={made}", f"gnc.fmu_process={'true' if form == 'isolated.fmu' else 'false'}"]


NO_FIGURES = "import hil.report.page as page; page.figures = lambda *_: ()"
FIRST = next(line for line in (EXAMPLES / "gnc_c" / "gnc.c").read_text().splitlines() if line.startswith("#include"))


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this computer")
@pytest.mark.parametrize("form", FORMS)
def test_code_that_a_recording_names_is_loaded_only_if_it_is_trusted(form: str, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    given = [text for setting in settings_of(form, tmp_path, ran) for text in ("--set", setting)]
    done = hil("run", "scheme-1", "--duration", "2", *given, "--record", str(tmp_path / "runs"))
    assert done.returncode in (PASSED, FAILED), done.stderr
    assert ran.exists()
    ran.unlink()
    (recording,) = (tmp_path / "runs").glob("*.mcap")
    refused = hil("replay", str(recording))
    assert (refused.returncode, len(refused.stderr.splitlines())) == (BAD_INPUT, 1), refused.stderr
    assert f"is code that {recording} names (sha256 " in refused.stderr
    assert "--trust-code" in refused.stderr
    for command in (
        ["report", str(recording), "--out", str(tmp_path / "page.html")],
        ["recordings", "verify", str(recording)],
    ):
        hil(*command, before=NO_FIGURES)
    assert not ran.exists()
    if form != "sensor.py":  # sensors cannot be changed in a replay
        named = hil("replay", str(recording), *given)
        assert named.returncode == PASSED, named.stderr
        assert ran.exists()
        ran.unlink()
    trusted = hil("replay", str(recording), "--trust-code")
    assert trusted.returncode == PASSED, trusted.stderr
    assert f"named by {recording}, sha256 " in trusted.stderr
    assert ran.exists()


def test_relative_names_of_data_are_never_loaded_and_those_of_the_user_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_code, "_of_data", {})
    monkeypatch.setattr(own_code, "_of_user", set())

    def refuse(text: str) -> BadInput:
        return BadInput.single("gnc", "library", text)

    content = json.loads('{"gnc": {"library": "./own.so", "control": {"backend": "package.module:Law"}, "fmu": "a"}}')
    note_data("run.mcap", content)
    for name in ("own.so", "package.module:Law", "a"):
        with pytest.raises(BadInput, match=r"is code that run.mcap names, not by an absolute path: never loaded"):
            require_trust(name, refuse)
    note_users(["own.so"])
    require_trust("own.so", refuse)
    require_trust("other.so", refuse)


@pytest.mark.parametrize("written", ["{0}//own", "{0}/./own", "{0}/sub/../own", "{0}/link"])
def test_one_file_is_one_code_however_its_path_is_written(
    written: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_code, "_of_data", {})
    (tmp_path / "own").touch()
    (tmp_path / "sub").mkdir()
    (tmp_path / "link").symlink_to("own")
    note_data("run.mcap", {"library": written.format(tmp_path)})
    with pytest.raises(BadInput, match=r"is code that run.mcap names \(sha256 e3b0c44298fc1c14\): not loaded"):
        require_trust(str(tmp_path / "own"), lambda text: BadInput.single("gnc", "library", text))


def test_digest_of_a_run_does_not_import_the_package_that_data_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "acme").mkdir()
    (tmp_path / "acme" / "__init__.py").write_text("raise SystemExit")
    (tmp_path / "acme" / "law.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert backend_file("acme.law:Law", "control") == str(tmp_path / "acme" / "law.py")
    assert backend_file("acme.missing:Law", "control") is None
