#!/usr/bin/env bash
# Style, types and the contracts of imports, with the tools of .venv (scripts/test.sh sets it up, and runs this first).
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
venv="$root/.venv"
cd "$root"

"$venv/bin/ruff" check .
"$venv/bin/ruff" format --check .

# mypy and the contracts of imports do not see the import hook of an editable install: show them the package as a wheel
# would lay it out.
typing="$root/build/typing"
rm -rf "$typing"
mkdir -p "$typing/tensegrity_mj" "$typing/evidence"
ln -s "$root"/tensegrity_mj/* "$typing/tensegrity_mj/"
ln -s "$root/controllers" "$root/models" "$typing/tensegrity_mj/"
ln -s "$root"/evidence/* "$typing/evidence/"
rm -f "$typing"/*/__pycache__ "$typing/evidence/tests"
cd "$typing"
"$venv/bin/python" -m mypy --config-file "$root/pyproject.toml" --cache-dir "$root/.mypy_cache" -p tensegrity_mj -p evidence
"$venv/bin/lint-imports" --config "$root/pyproject.toml" --no-logo
