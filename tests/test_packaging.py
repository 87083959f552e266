"""What the wheel holds: the package alone, with laws and scenes inside it."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("tensegrity_mj", "controllers", "models", "pyproject.toml", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The names in a wheel built from a copy of the sources (building in place would leave files behind)."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    pip = [sys.executable, "-m", "pip"]
    if subprocess.run([*pip, "--version"], capture_output=True).returncode:
        # The environment of scripts/setup.sh may have no pip of its own and borrow one.
        borrowed = shutil.which("pip") or shutil.which("pip3")
        if borrowed is None:
            pytest.skip("no pip on this machine to build a wheel with")
        pip = [borrowed, "--python", sys.executable]
    build = subprocess.run(
        [*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", str(out), str(source)], capture_output=True, text=True
    )
    if build.returncode:
        unreachable = ("No matching distribution found for setuptools", "Could not find a version", "ConnectionError")
        if any(sign in build.stderr for sign in unreachable):
            pytest.skip("the build backend setuptools cannot be downloaded here")
        pytest.fail(build.stderr)
    (wheel,) = out.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


@pytest.mark.parametrize("script", ["scripts/demo.sh", "scripts/test.sh", "scripts/setup.sh", ".ci/run"])
def test_scripts_are_valid(script: str) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash on this machine")
    check = subprocess.run([bash, "-n", str(ROOT / script)], capture_output=True, text=True)
    assert check.returncode == 0, check.stderr


def test_nothing_but_the_package_lands_in_site_packages(names: list[str]) -> None:
    tops = {name.partition("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"tensegrity_mj"}


def test_laws_and_scenes_are_inside_the_package(names: list[str]) -> None:
    expected = {
        f"tensegrity_mj/{path.relative_to(ROOT)}"
        for path in [*(ROOT / "controllers").glob("*.py"), *(ROOT / "models").rglob("*.*")]
        if path.suffix in {".py", ".toml", ".xml", ".md", ".png"} and "__pycache__" not in path.parts
    }
    assert any(name.endswith(".toml") for name in expected)
    assert expected <= set(names)


def test_every_module_of_the_checkout_is_in_the_wheel(names: list[str]) -> None:
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "tensegrity_mj").rglob("*.py")}
    assert modules <= set(names)


def test_license_and_type_marker_are_included(names: list[str]) -> None:
    assert any(name.endswith("LICENSE") and ".dist-info/" in name for name in names)
    assert "tensegrity_mj/py.typed" in names
