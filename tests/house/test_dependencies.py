"""pip can install what pyproject.toml requires on each Python; nothing but its adapter needs dm-control."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import study_tasks
from packaging.markers import Marker
from packaging.requirements import Requirement

import tensegrity_mj as tmj
from tensegrity_mj.basics import dependencies
from tensegrity_mj.commands import doctor
from tensegrity_mj.commands.doctor import check_dm_control, check_packages
from tensegrity_mj.errors import MissingLibraryError, MissingPackageError
from tensegrity_mj.exchange import import_scene

ROOT = Path(__file__).resolve().parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if "Python :: 3." in text]


def wanted(python: str) -> dict[str, Requirement]:
    """What pip installs with the package in a Python, by name."""
    items = [Requirement(line) for line in PROJECT["dependencies"]]
    environment = {"python_version": python, "python_full_version": f"{python}.0"}
    return {item.name: item for item in items if (item.marker or Marker("os_name != ''")).evaluate(environment)}


def test_dm_control_is_a_default_where_pip_can_install_it() -> None:
    assert PYTHONS == ["3.11", "3.12", "3.13", "3.14"]
    # labmaze 1.0.6, which dm-control requires, has wheels up to CPython 3.12 and no sources that pip could build.
    assert [python for python in PYTHONS if "dm-control" in wanted(python)] == ["3.11", "3.12"]
    assert wanted("3.12").keys() - wanted("3.13").keys() == {"dm-control"}


def test_the_set_up_script_and_the_guides_know_the_same_pythons() -> None:
    script = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    assert f"for newest in {PYTHONS[-1].partition('.')[2]} 99;" in script
    assert all(f" python{python}" in script for python in PYTHONS)


def test_the_extra_is_what_dm_control_requires_less_labmaze() -> None:
    """Its own metadata says what it requires; our default dependencies are there already."""
    try:
        lines = metadata.requires("dm-control") or []
    except metadata.PackageNotFoundError:
        pytest.skip("dm-control is not installed")
    items = [Requirement(line) for line in lines]
    theirs = {item.name: str(item.specifier) for item in items if "extra" not in str(item.marker)}
    assert "labmaze" in theirs, "dm-control no longer requires labmaze: it can be a default dependency everywhere"
    extra = {
        item.name: str(item.specifier)
        for item in map(Requirement, PROJECT["optional-dependencies"][dependencies.EXTRA])
    }
    defaults = set(wanted("3.13"))
    assert extra == {name: text for name, text in theirs.items() if name not in defaults | {"labmaze"}}


# Everything of dm-control's that the adapter and its guide use, without labmaze.
WITHOUT_LABMAZE = """
import sys
sys.modules["labmaze"] = None
import tensegrity_mj as tmj
from tensegrity_mj.learning.dm_control import TensegrityEntity, TensegrityTask, environment
from dm_control import composer, mjcf
env = environment(tmj.load_scene("pinned_rod"), time_limit=0.01)
env.reset()
assert env.step(env.action_spec().minimum).last()
arena = composer.Arena()
arena.attach(TensegrityEntity(tmj.load_scene("pinned_rod")))
mjcf.Physics.from_mjcf_model(arena.mjcf_model).step()
assert not any(name.startswith("dm_control.locomotion") for name in sys.modules)
"""


def child(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-W", "ignore", "-c", code, *arguments], capture_output=True, text=True)


def test_the_adapter_works_without_labmaze() -> None:
    if dependencies.missing_for_dm_control():
        pytest.skip(f"not installed: {', '.join(dependencies.missing_for_dm_control())}")
    run = child(WITHOUT_LABMAZE)
    assert run.returncode == 0, run.stderr


def test_dm_control_is_here_where_pip_installs_it() -> None:
    """Otherwise the adapter's tests would be skipped without anybody's notice."""
    if "dm-control" in wanted(f"3.{sys.version_info[1]}"):
        assert not dependencies.missing_for_dm_control()


# A machine without dm-control and what comes along with it alone: neither their modules nor their metadata are found.
ABSENT = """
import sys
from importlib import metadata
for name in ("dm_control", "dm_env", "tree", "labmaze", "lxml", "requests", "google.protobuf"):
    sys.modules[name] = None
found = metadata.Distribution.from_name
def from_name(name):
    if name in ("dm-control", "dm-env", "dm-tree", "labmaze", "lxml", "requests", "protobuf"):
        raise metadata.PackageNotFoundError(name)
    return found(name)
metadata.Distribution.from_name = from_name
"""


def test_the_import_without_dm_control_says_what_to_install() -> None:
    code = f"""{ABSENT}
try:
    import tensegrity_mj.learning.dm_control
except ImportError as error:
    from tensegrity_mj.errors import MissingLibraryError
    assert isinstance(error, MissingLibraryError)
    print(error)
"""
    run = child(code)
    assert run.returncode == 0, run.stderr
    assert "tensegrity_mj.learning.dm_control needs packages that are not installed: dm-env" in run.stdout
    assert "dm-control>=1.0.50" in run.stdout
    assert "python -m pip install " in run.stdout
    assert "all else of tensegrity_mj works without them" in run.stdout


def test_everything_else_works_without_dm_control() -> None:
    """Each module but the adapter's is imported, and a run and a command end well."""
    code = f"""{ABSENT}
import importlib, pkgutil
import tensegrity_mj as tmj
seen = 0
for module in pkgutil.walk_packages(tmj.__path__, "tensegrity_mj.", onerror=lambda name: None):
    of_others = module.name.startswith("tensegrity_mj.learning.dm_control") or module.name.endswith("stable_baselines")
    if not of_others and not module.name.endswith("__main__"):
        importlib.import_module(module.name)
        seen += 1
assert seen > 100, seen
run = tmj.simulate(tmj.load_scene("pinned_rod"), None, tmj.MuJoCo(1e-3), duration=0.01)
assert run.status is tmj.Status.COMPLETED
from tensegrity_mj.cli import main
raise SystemExit(main(["scenes"]))
"""
    run = child(code)
    assert run.returncode == 0, run.stderr
    assert "pinned_rod" in run.stdout


def test_missing_packages_are_missing_libraries_and_missing_modules() -> None:
    error = MissingPackageError("x")
    assert isinstance(error, MissingLibraryError)
    assert isinstance(error, ModuleNotFoundError)  # what pytest.importorskip and pydoc expect of an import


@pytest.mark.parametrize(
    ("python", "commands"),
    [
        ((3, 12), ['python -m pip install "dm-env" "dm-control>=1.0.50"']),
        ((3, 13), ['python -m pip install "dm-env"', 'python -m pip install --no-deps "dm-control>=1.0.50"']),
    ],
)
def test_what_to_install_depends_on_the_python(python: tuple[int, int], commands: list[str]) -> None:
    missing = ["dm-env", "dm-control>=1.0.50"]
    assert dependencies.how_to_install(missing, python) == " && ".join(commands)
    assert dependencies.how_to_install(missing[1:], (3, 14)) == 'python -m pip install --no-deps "dm-control>=1.0.50"'


def test_an_old_version_counts_as_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ['dm-env>=999; extra == "dm-control-needs"', 'other; extra == "dev"', "dm-control>=0; python_version < '3'"]
    monkeypatch.setattr(dependencies.metadata, "requires", lambda name: lines)
    assert dependencies.missing_for_dm_control()[0] == "dm-env>=999"
    assert not any("other" in name for name in dependencies.missing_for_dm_control())


def test_the_doctor_reports_dm_control_apart_and_without_failing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dependencies, "missing_for_dm_control", lambda: ["dm-env", "dm-control>=1.0.50"])
    check = check_dm_control()
    assert not check.works
    assert not check.required  # everything but the adapter works
    assert check.found == "not installed: dm-env, dm-control>=1.0.50"
    assert "tensegrity_mj.learning.dm_control" in check.needed_for
    assert "pip install" in check.remedy
    monkeypatch.setattr(dependencies, "missing_for_dm_control", list)
    monkeypatch.setattr(doctor, "_run_probe", lambda code: (False, "broken on purpose"))
    broken = check_dm_control()
    assert not broken.works
    assert broken.found == "broken on purpose"
    assert broken.remedy


def test_the_doctor_looks_for_what_this_python_requires(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy>=1; python_version < '3'", "scipy>=1; python_version >= '3'", 'ruff; extra == "dev"', "dm-control"]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: lines)
    assert [check.name for check in check_packages()] == ["scipy"]


def test_a_test_that_hangs_is_ended(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    """By our own options but the limit itself, which is minutes: the test fails, and the next one runs."""
    assert pytestconfig.pluginmanager.hasplugin("timeout")
    assert 60 <= float(pytestconfig.getini("timeout")) < float(pytestconfig.getini("faulthandler_timeout"))
    assert pytestconfig.getini("faulthandler_exit_on_timeout") is True
    (tmp_path / "test_two.py").write_text(
        "import time\ndef test_hangs():\n    while True:\n        time.sleep(0.01)\ndef test_next():\n    pass\n"
    )
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "-o", "timeout=0.5"]
    run = subprocess.run(
        [*command, "--rootdir", str(tmp_path), "-p", "no:cacheprovider", str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert run.returncode == 1, run.stdout + run.stderr
    assert "1 failed, 1 passed" in run.stdout
    assert re.search(r"Timeout.*0\.5", run.stdout)


def test_the_core_requires_fifteen_packages_at_most() -> None:
    """Five that many users do without are extras, which the demo's environment has all the same."""
    small = {"studies", "allocation", "fatigue", "ntrt", "completion"}
    assert len(wanted("3.12")) <= 15
    assert small <= set(PROJECT["optional-dependencies"])
    script = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    (line,) = re.findall(r'--editable "\$root\[([\w,]+)\]"\)', script)
    assert set(line.split(",")) == small


def test_without_the_package_of_an_extra_its_part_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("joblib", "rainflow", "daqp", "yaml"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "tensegrity_mj.exchange.ntrt", raising=False)
    monkeypatch.delitem(sys.modules, "tensegrity_mj.exchange.ntrt", raising=False)
    with pytest.warns(RuntimeWarning, match=r"one at a time: joblib cannot be imported.*pip install .?joblib"):
        study = tmj.studies.run_many(study_tasks.noted, [{"x": 3.0}], None, workers=tmj.studies.Workers(2))
    assert len(study.outcomes) == 1
    run = tmj.simulate("prism", None, tmj.MuJoCo(1e-2), duration=0.1)
    with pytest.raises(MissingPackageError, match="the count of cycles needs rainflow"):
        run.statistics("tension").cycles(run.scene.structure.strings[0].name)
    (path := tmp_path / "model.yaml").write_text("nodes: {}\n", encoding="utf-8")
    with pytest.raises(MissingPackageError, match="a model of NTRT needs yaml"):
        import_scene(path)
