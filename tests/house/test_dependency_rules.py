"""What imports what: the contracts of pyproject.toml are checked beside the tests; here is what they cannot see."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_importing_the_dae_leaves_mujoco_out() -> None:
    code = (
        "import sys, tensegrity_mj as tmj\n"
        "import tensegrity_mj.engines.reference.dae, tensegrity_mj.controllers, tensegrity_mj.dynamics\n"
        "tmj.DAE(), tmj.ODE(), tmj.load_scene('prism'), tmj.Trajectory\n"
        "assert 'mujoco' not in sys.modules and 'dm_control' not in sys.modules\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_tests_import_nothing_from_other_tests() -> None:
    """What two of them need is a fixture of conftest.py or a module in helpers/; no fixture stands copied."""
    files = sorted(path for folder in ("tests", "evidence/tests") for path in (ROOT / folder).rglob("test_*.py"))
    assert len(files) > 90
    places: dict[str, list[str]] = {}
    for path in files:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.startswith("test_")], path.name
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and any("fixture" in ast.dump(one) for one in node.decorator_list):
                places.setdefault(ast.dump(ast.Module(node.body, [])), []).append(f"{path.name}: {node.name}")
    assert not [where for where in places.values() if len(where) > 1]
