"""What the wheel holds: the package alone, with laws and scenes inside it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
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
    shipped = source / "tensegrity_mj" / "dynamics" / "native" / "shipped"  # of scripts/compile_ahead.py --ship
    shipped.mkdir(exist_ok=True)
    (shipped / "any.nbc").write_text("machine code")
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


@pytest.mark.parametrize(
    "script",
    ["scripts/demo.sh", "scripts/test.sh", "scripts/docs.sh", "scripts/lint.sh", "scripts/setup.sh", ".ci/run"],
)
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
        if path.suffix in {".py", ".toml", ".xml", ".md", ".png", ".csv"} and "__pycache__" not in path.parts
    }
    assert any(name.endswith(".toml") for name in expected)
    assert expected <= set(names)


def test_every_module_of_the_checkout_is_in_the_wheel(names: list[str]) -> None:
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "tensegrity_mj").rglob("*.py")}
    assert modules <= set(names)


def test_machine_code_that_was_compiled_ahead_is_included(names: list[str]) -> None:
    assert "tensegrity_mj/dynamics/native/shipped/any.nbc" in names


def test_license_and_type_marker_are_included(names: list[str]) -> None:
    assert any(name.endswith("LICENSE") and ".dist-info/" in name for name in names)
    assert "tensegrity_mj/py.typed" in names


# scripts/setup.sh, function by function, with a stand-in for pip


def in_setup(code: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run bash code after sourcing setup.sh, with an environment in `folder` instead of .venv."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash on this machine")
    script = f'set -euo pipefail; source "{ROOT}/scripts/setup.sh"; venv="{folder}"; {code}'
    environ = {**{key: value for key, value in os.environ.items() if key != "PYTHON"}, **variables}
    return subprocess.run([bash, "-c", script], capture_output=True, text=True, env=environ)


def stand_in(path: Path, body: str) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


def test_python_chooses_and_nothing_else_is_taken_instead(tmp_path: Path) -> None:
    chosen = in_setup("find_python", tmp_path, PYTHON=sys.executable)
    assert chosen.stdout.strip() == sys.executable
    for wrong in ("/bin/false", "/no/such/python"):
        refused = in_setup("find_python", tmp_path, PYTHON=wrong)
        assert refused.returncode == 1
        assert not refused.stdout
        assert f"PYTHON={wrong} is no Python 3.11 or newer" in refused.stderr


def test_a_python_that_was_tried_comes_before_a_newer_one(tmp_path: Path) -> None:
    """Stand-ins answer the script's question: whether they are at most version 3.<its second argument>."""
    path = f"{tmp_path}:{os.environ['PATH']}"
    stand_in(tmp_path / "python3", '[ "$3" -ge 99 ]')  # a version not tried yet
    stand_in(tmp_path / "python3.13", "exit 0")
    for name in ("python3.14", "python3.12", "python3.11", "python"):
        stand_in(tmp_path / name, "exit 1")
    assert in_setup("find_python", tmp_path, PATH=path).stdout.strip() == str(tmp_path / "python3.13")
    stand_in(tmp_path / "python3.13", "exit 1")
    newer = in_setup("find_python", tmp_path, PATH=path)
    assert newer.stdout.strip() == str(tmp_path / "python3")
    assert "newer than 3.14" in newer.stderr
    stand_in(tmp_path / "python3", "exit 1")
    none = in_setup("find_python", tmp_path, PATH=path)
    assert none.returncode == 1
    assert "Python 3.11 or newer is needed" in none.stderr


# What is missing is what the file says; pip is a stand-in that notes how it is called.
DM_CONTROL = """
missing_for_dm_control() { cat "$venv/missing"; }
pip_install() { shift; echo "$*" >>"$venv/calls"; [ -z "${FAILS:-}" ] || return 1; : >"$venv/missing"; }
see_to_dm_control python
"""


def test_dm_control_is_installed_without_its_dependencies_once(tmp_path: Path) -> None:
    (tmp_path / "missing").write_text("dm-env\nlxml>=4\ndm-control>=1.0.50")
    run = in_setup(DM_CONTROL, tmp_path)
    assert run.returncode == 0, run.stderr
    needs, alone = (tmp_path / "calls").read_text().splitlines()
    assert needs.endswith(" dm-env lxml>=4")
    assert "--no-deps" not in needs
    assert alone.endswith(" --no-deps dm-control>=1.0.50")
    assert "without labmaze" in run.stderr
    again = in_setup(DM_CONTROL, tmp_path)  # nothing is missing any more
    assert (again.returncode, again.stderr) == (0, "")
    assert len((tmp_path / "calls").read_text().splitlines()) == 2


def test_without_dm_control_the_set_up_goes_on_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "missing").write_text("dm-env\ndm-control>=1.0.50")
    for _ in range(2):  # the second tries nothing, so that it needs no network
        run = in_setup(DM_CONTROL, tmp_path, FAILS="yes")
        assert run.returncode == 0
        assert "No tensegrity_mj.learning.dm_control" in run.stderr
        assert "dm-env dm-control>=1.0.50" in run.stderr
        assert "tensegrity-mj doctor" in run.stderr
        assert len((tmp_path / "calls").read_text().splitlines()) == 1


def project() -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return found


def test_the_version_is_the_same_wherever_it_stands() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, re.MULTILINE)[1] == project()["project"]["version"]  # type: ignore[index]
    evidence = tomllib.loads((ROOT / "evidence" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert evidence["version"] == project()["project"]["version"]
    assert evidence["dependencies"] == [f"tensegrity-mj[allocation,studies]=={evidence['version']}"]
    assert f"\nlicense: {project()['project']['license']}\n" in citation
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.search(r"^## \[([\d.]+)\] - (\d{4}-\d\d-\d\d)$", changes, re.MULTILINE)  # the newest stands first
    assert released
    assert released[1] == project()["project"]["version"]
    assert re.search(r"^date-released: (\S+)$", citation, re.MULTILINE)[1] == released[2]  # type: ignore[index]


def test_all_is_every_extra_of_users() -> None:
    extras = project()["project"]["optional-dependencies"]
    (line,) = extras["all"]
    assert set(Requirement(line).extras) == set(extras) - {"all", "dev", "docs", "dm-control-needs"}
    rows = re.findall(r"^\| `([\w-]+)` \|", (ROOT / "docs/install.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted(extras)


def test_hosted_ci_runs_what_the_checkout_runs_on_every_python_that_is_declared() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    declared = [line.rpartition(" ")[2] for line in project()["project"]["classifiers"] if ":: 3." in line]
    assert job["strategy"]["matrix"]["python"] == declared
    assert [step["run"] for step in job["steps"] if "run" in step] == ["bash .ci/run"]


def test_hooks_use_tools_that_the_set_up_installs() -> None:
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    pinned = {Requirement(line).name for line in project()["project"]["optional-dependencies"]["dev"]}
    for hook in config["repos"][0]["hooks"]:
        tool = hook["entry"].split()[0]
        assert tool == "bash" or tool.removeprefix(".venv/bin/") in pinned


def test_the_container_gets_all_that_the_package_is_built_of_and_the_libraries_of_the_scripts() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = {word for line in re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE) for word in line.split()}
    assert copied == {*SOURCES, "scripts/compile_ahead.py"}
    let_in = re.findall(r"^!(.*)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(let_in) == copied
    packages = re.search(r"local packages=\((.*)\)", (ROOT / "scripts/setup.sh").read_text(encoding="utf-8"))
    assert packages
    assert f"--no-install-recommends {packages[1]} " in text
