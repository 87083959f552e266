"""The doctor finds what is broken and says how to mend it."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tensegrity_mj.commands import doctor
from tensegrity_mj.commands.doctor import (
    CHECKS,
    check_display,
    check_opengl,
    check_package,
    examine,
    probed,
)
from tensegrity_mj.dynamics.native import kept

OPENGL_PACKAGES = CHECKS["opengl"]["remedy"].partition("apt-get install ")[2]


def test_this_machine_has_what_simulation_needs() -> None:
    for check in examine():
        if check.needed_for == "everything":
            assert check.works, f"{check.name}: {check.found}; {check.remedy}"
            assert check.found
            assert not check.remedy


def test_every_failure_names_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_run_probe", lambda code: (False, "broken on purpose"))
    assert "JAX" in {check.name for check in examine()}
    for check in (probed("compiler"), check_opengl(), probed("jax")):
        assert not check.works
        assert "broken on purpose" in check.found
        assert check.remedy


def test_a_missing_package_and_an_old_one_are_distinguished() -> None:
    missing = check_package(Requirement("no-such-package-of-ours>=1"))
    assert not missing.works
    assert missing.found == "not installed"
    assert 'install "no-such-package-of-ours>=1"' in missing.remedy
    old = check_package(Requirement("numpy>=999"))
    assert not old.works
    assert "needed: >=999" in old.found
    assert check_package(Requirement("numpy>=1")).works


def test_a_package_whose_files_were_removed_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As pip leaves MuJoCo that it brings from 3.x to 4.0: findings/mujoco_upgrade_by_pip.sh."""
    for name, requires in {"ours-whole": "Requires-Dist: ours-core>=1\n", "ours-core": ""}.items():
        folder = tmp_path / f"{name.replace('-', '_')}-1.0.dist-info"
        folder.mkdir()
        text = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{requires}"
        (folder / "METADATA").write_text(text, encoding="utf-8")
        (folder / "RECORD").write_text(f"{name}.py,,\n{name}.pyc,,\n", encoding="utf-8")
        (tmp_path / f"{name}.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert check_package(Requirement("ours-whole")).works
    (tmp_path / "ours-core.py").unlink()
    monkeypatch.setattr(doctor.metadata, "files", lambda name: [])  # from Python 3.12 on: no file that is gone
    found = check_package(Requirement("ours-whole"))
    assert not found.works
    assert found.found == "1.0, without files of ours-core"
    assert found.remedy.endswith("--force-reinstall --no-deps ours-core ours-whole")


def test_opengl_that_is_switched_off_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    check = check_opengl()
    assert not check.works
    assert check.required
    assert check.needed_for == "video"
    assert "MUJOCO_GL=disabled" in check.found
    assert check.remedy.startswith("unset MUJOCO_GL")
    assert OPENGL_PACKAGES in check.remedy


def test_a_chosen_opengl_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(doctor, "_run_probe", lambda code: (False, "broken on purpose"))
    assert check_opengl().found == "broken on purpose (MUJOCO_GL=osmesa)"


def test_opengl_names_what_it_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    check = check_opengl()
    if not check.works:
        pytest.skip(f"no OpenGL here: {check.found}")
    kind, _, renderer = check.found.partition(": ")
    assert kind in {"egl", "osmesa", "glfw", "cgl"}
    assert renderer


def test_a_probe_that_dies_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CHECKS["opengl"], "probe", "import os; os.abort()")
    check = check_opengl()
    assert not check.works
    assert check.found.startswith("ended with code")


def test_ffmpeg_that_cannot_be_run_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "none"))
    check = probed("ffmpeg")
    assert not check.works
    assert check.remedy


def test_ffmpeg_without_h264_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = tmp_path / "ffmpeg"
    fake.write_text("#!/bin/sh\necho ' V....D mpeg4'\n")
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake))
    check = probed("ffmpeg")
    assert not check.works
    assert "H.264" in check.found


def test_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.sys, "platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    assert not check_display().works
    monkeypatch.setenv("DISPLAY", ":7")
    assert check_display().found == "DISPLAY=:7"


# Root may write anywhere: that the tree is read-only is said to what tries.
READ_ONLY_TREE = """
import pathlib, tempfile
def temporary_file(dir, really=tempfile.TemporaryFile):
    if pathlib.Path(dir).name == "__pycache__":
        raise OSError("read-only")
    return really(dir=dir)
tempfile.TemporaryFile = temporary_file
"""


def test_where_the_doctor_says_the_numba_cache_is_there_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """NUMBA_CACHE_DIR, beside the source, XDG_CACHE_HOME: the first that can be written."""
    beside = Path(kept.__file__).parent / "__pycache__"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "not" / "yet"))
    assert Path(probed("cache").found).parent == tmp_path / "not" / "yet"
    for none in ("", str(tmp_path / "file")):
        monkeypatch.setenv("NUMBA_CACHE_DIR", none)
        check = probed("cache")
        assert check.works, check.found
        assert Path(check.found) == beside
    monkeypatch.setitem(CHECKS["cache"], "probe", READ_ONLY_TREE + CHECKS["cache"]["probe"])
    check = probed("cache")
    assert check.works, check.found
    assert Path(check.found).parent == tmp_path / "cache" / "tensegrity-mj"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    check = probed("cache")
    assert not check.works
    assert check.found
    assert "NUMBA_CACHE_DIR" in check.remedy


def test_an_unknown_kind_of_opengl_is_reported_with_those_that_are_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "paper")
    check = check_opengl()
    assert not check.works
    assert "MUJOCO_GL=paper: allowed are egl, osmesa and glfw" in check.found
    assert check.remedy.startswith("unset MUJOCO_GL")


def test_the_set_up_script_installs_the_packages_that_the_doctor_names() -> None:
    script = (Path(__file__).resolve().parents[2] / "scripts" / "setup.sh").read_text(encoding="utf-8")
    assert f"packages=({OPENGL_PACKAGES})" in script
