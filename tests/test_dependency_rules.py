"""The dependency rules of the architecture, over every import of every module, function-level imports included."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {"tensegrity_mj": ROOT / "tensegrity_mj", "tensegrity_mj.controllers": ROOT / "controllers"}
CORE = {
    f"tensegrity_mj.{name}"
    for name in (
        "structure",
        "scene",
        "contact",
        "curve",
        "checks",
        "strings",
        "errors",
        "texts",
        "validation",
        "validation.values",
        "validation.geometry",
        "validation.members",
        "validation.structures",
        "validation.configurations",
        "validation.targets",
        "validation.contacts",
        "validation.resistances",
        "validation.waters",
        "validation.scenes",
        "motion",
        "moved_supports",
        "joints",
        "resistance",
        "water",
        "water_segments",
        "waves",
        "redundancy",
        "section",
    )
}

# Who may import mujoco itself (or dm_control, which imports it), besides the MuJoCo engine: modules and packages.
MAY_IMPORT_MUJOCO = {
    "tensegrity_mj.benchmark",
    "tensegrity_mj.mjcf",
    "tensegrity_mj.pictures",
    "tensegrity_mj.rendering",
    "tensegrity_mj.scene_requirements",
    "tensegrity_mj.step_timing",
    "tensegrity_mj.view",
    "tensegrity_mj.dm_control",
    "tensegrity_mj.studies.extremes.naive",  # steps MuJoCo as a script of one's own would
}


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join([package, *(part for part in parts if part != "__init__")])] = path
    return found


MODULES = modules()


def imports_of(source: str, module: str, is_package: bool) -> set[str]:
    """Dotted names that the source imports: `from a import b` gives a, and a.b where that is a module of ours.

    Imports for annotations only (`if TYPE_CHECKING:`) count too: a module that names another's types depends on it.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = module.split(".")
                parent = parent[: len(parent) - node.level + is_package]
                base = ".".join([*parent, *([base] if base else [])])
            submodules = {f"{base}.{alias.name}" for alias in node.names} & set(MODULES)
            names.update(submodules)
            # `from package import submodule` alone does not use what the package itself holds.
            if len(submodules) < len(node.names):
                names.add(base)
        elif isinstance(node, ast.Call):
            function = node.func
            called = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
            if called in {"import_module", "__import__"} and node.args and isinstance(node.args[0], ast.Constant):
                names.add(str(node.args[0].value))
    return names


IMPORTS = {
    name: imports_of(path.read_text(encoding="utf-8"), name, path.name == "__init__.py")
    for name, path in MODULES.items()
}


def within(name: str, *packages: str) -> bool:
    """Whether a dotted name is one of the packages or lies in one."""
    return any(name == package or name.startswith(package + ".") for package in packages)


def offenders(sources: set[str], *forbidden: str, except_for: set[str] = frozenset()) -> list[str]:  # type: ignore[assignment]
    return sorted(
        f"{source} imports {name}"
        for source in sources
        for name in IMPORTS[source]
        if within(name, *forbidden) and name != source and name not in except_for
    )


def test_the_parser_of_imports_sees_every_kind() -> None:
    source = """
import numpy as np
from . import sibling
from ..strings import tension
def f():
    import mujoco.viewer
    from tensegrity_mj import structure
    importlib.import_module("scipy.linalg")
"""
    assert imports_of(source, "tensegrity_mj.engines.dae", False) == {
        "numpy",
        "tensegrity_mj.engines",
        "tensegrity_mj.strings",
        "mujoco.viewer",
        "tensegrity_mj.structure",
        "scipy.linalg",
    }


def test_all_of_the_package_is_looked_at() -> None:
    assert CORE | {"tensegrity_mj", "tensegrity_mj.cli", "tensegrity_mj.controllers"} <= set(MODULES)
    assert {"tensegrity_mj.engines.dae", "tensegrity_mj.engines.mujoco"} <= set(MODULES)


@pytest.mark.parametrize("module", sorted(CORE))
def test_the_core_imports_numpy_only(module: str) -> None:
    allowed = {"numpy", "__future__"} | set(sys.stdlib_module_names)
    foreign = {name for name in IMPORTS[module] if name.partition(".")[0] not in allowed and name not in CORE}
    assert not foreign, f"{module} imports {sorted(foreign)}"


def test_controllers_never_import_engines() -> None:
    laws = {name for name in MODULES if within(name, "tensegrity_mj.controllers")}
    assert not offenders(laws, "tensegrity_mj.engines", "tensegrity_mj.simulation", "mujoco", "dm_control")


def engine_family(name: str) -> set[str]:
    """The modules of one engine: engines/<name>.py, engines/<name>_*.py."""
    found = {module for module in MODULES if module.startswith(f"tensegrity_mj.engines.{name}")}
    assert found
    return found


def test_engines_never_import_controllers_or_each_other() -> None:
    engines = {name for name in MODULES if within(name, "tensegrity_mj.engines")} - {"tensegrity_mj.engines"}
    assert not offenders(engines, "tensegrity_mj.controllers")
    families = {family: engine_family(family) for family in ("dae", "ode", "mujoco")}
    for family, modules in families.items():
        others = set().union(*(others for other, others in families.items() if other != family))
        assert not offenders(modules, *others)
    # What they share knows none of them.
    shared = {name for name in engines if not any(name in family for family in families.values())}
    assert {"tensegrity_mj.engines.run", "tensegrity_mj.engines.integration"} <= shared
    assert not offenders(shared, *set().union(*families.values()))


def test_only_a_few_modules_import_mujoco() -> None:
    others = {module for module in MODULES if not within(module, *MAY_IMPORT_MUJOCO)} - engine_family("mujoco")
    assert not offenders(others, "mujoco", "dm_control")


def test_no_library_module_imports_tests_or_models() -> None:
    assert not offenders(set(MODULES), "tests", "models", "controllers", "tensegrity_mj.models")


def reachable(start: str) -> set[str]:
    """Everything of ours that importing and using a module may import, directly or not."""
    todo, seen = [start], set()
    while todo:
        module = todo.pop()
        if module in seen or module not in IMPORTS:
            continue
        seen.add(module)
        todo.extend(IMPORTS[module])
    return seen


def test_dae_and_ode_never_reach_mujoco() -> None:
    starts = (
        engine_family("dae")
        | engine_family("ode")
        | {name for name in MODULES if within(name, "tensegrity_mj.dynamics")}
    )
    for module in set().union(*(reachable(start) for start in starts)):
        assert not offenders({module}, "mujoco", "dm_control")


def test_importing_the_dae_leaves_mujoco_out() -> None:
    code = (
        "import sys, tensegrity_mj as tmj\n"
        "import tensegrity_mj.engines.dae, tensegrity_mj.controllers, tensegrity_mj.dynamics\n"
        "tmj.DAE(), tmj.ODE(), tmj.load_scene('prism'), tmj.Trajectory\n"
        "assert 'mujoco' not in sys.modules and 'dm_control' not in sys.modules\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_tests_import_nothing_from_other_tests() -> None:
    """What two of them need is a fixture of conftest.py or a module without `test_`; no fixture stands copied."""
    files = sorted((ROOT / "tests").glob("test_*.py"))
    assert len(files) > 90
    places: dict[str, list[str]] = {}
    for path in files:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = imports_of(path.read_text(encoding="utf-8"), path.stem, False)
        assert not [name for name in imported if name.startswith("test_")], path.name
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and any("fixture" in ast.dump(one) for one in node.decorator_list):
                places.setdefault(ast.dump(ast.Module(node.body, [])), []).append(f"{path.name}: {node.name}")
    assert not [where for where in places.values() if len(where) > 1]
