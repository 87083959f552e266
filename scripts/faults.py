"""Put each fault of tests/faults.toml into a copy of the sources, and see the test of its kind fail.

    python scripts/faults.py  # all, in ten minutes or so; exit code 1 where a test misses one
    python scripts/faults.py 3 17  # those of these numbers
    python scripts/faults.py --check  # only that each can be put in

Run it with the Python of .venv, before and after tests are made fewer or shorter.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("tensegrity_mj", "controllers")
LEFT_OUT = shutil.ignore_patterns(".*", "build", "shared", "site")


def place(root: Path, text: str) -> Path:
    """The one source with this text.

    Raises:
        ValueError: where it stands in none, or more than once.
    """
    paths = [path for folder in SOURCES for path in (root / folder).rglob("*.py") if not path.is_symlink()]
    counts = {path: found for path in paths if (found := path.read_text(encoding="utf-8").count(text))}
    if sum(counts.values()) != 1:
        raise ValueError(f"its text stands {sum(counts.values())} times in {', '.join(SOURCES)}; it must be once")
    return next(iter(counts))


def copied(folder: Path) -> Path:
    """A copy of the checkout in `folder`, which Python imports before what is installed."""
    root = folder / "copy"
    shutil.copytree(ROOT, root, ignore=LEFT_OUT)
    for name in ("controllers", "models"):  # as a wheel has them
        (root / "tensegrity_mj" / name).symlink_to(root / name, target_is_directory=True)
    return root


def tested(root: Path, *arguments: str) -> bool:
    """Whether pytest passes in the copy."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-x", "-p", "no:cacheprovider", *arguments]
    environment = os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True)
    return done.returncode in (0, 5)  # 5: none of them is run without -m study


def caught(root: Path, fault: dict[str, Any]) -> bool:
    """Whether the test of a fault fails with it."""
    path = place(root, fault["text"])
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole.replace(fault["text"], fault["fault"]), encoding="utf-8")
    try:
        return not tested(root, fault["test"])
    finally:
        path.write_text(whole, encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("numbers", nargs="*", type=int, help="of the faults (default: all)")
    parser.add_argument("--check", action="store_true", help="put none in")
    given = parser.parse_args()
    faults = tomllib.loads((ROOT / "tests" / "faults.toml").read_text(encoding="utf-8"))["fault"]
    chosen = [one for one in faults if not given.numbers or one["number"] in given.numbers]
    missed = 0
    for fault in chosen:
        try:
            place(ROOT, fault["text"])
        except ValueError as error:
            print(f"{fault['number']}: {error}")
            missed += 1
    if given.check or missed:
        return int(missed > 0)
    with tempfile.TemporaryDirectory() as folder:
        root = copied(Path(folder))
        if not tested(root, *{one["test"] for one in chosen}):
            print("without a fault the tests do not pass")
            return 1
        for fault in chosen:
            seen = caught(root, fault)
            missed += not seen
            print(f"{fault['number']}: {'caught' if seen else 'MISSED'} by {fault['test']}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} faults are caught")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
