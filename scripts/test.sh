#!/usr/bin/env bash
# Sets everything up in .venv of this checkout, then checks style and types and runs the tests.
# Arguments are passed on to pytest, which runs as many processes as there are cores (-n 0: this one alone).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up dev
cd "$root"

"$venv/bin/ruff" check .
"$venv/bin/ruff" format --check .

# mypy and the contracts of imports do not see the import hook of an editable install: show them the package as a wheel
# would lay it out.
typing="$root/build/typing"
rm -rf "$typing"
mkdir -p "$typing/tensegrity_mj"
ln -s "$root"/tensegrity_mj/* "$typing/tensegrity_mj/"
ln -s "$root/controllers" "$root/models" "$typing/tensegrity_mj/"
rm -f "$typing/tensegrity_mj/__pycache__"
(cd "$typing" && "$venv/bin/python" -m mypy --config-file "$root/pyproject.toml" -p tensegrity_mj)
(cd "$typing" && "$venv/bin/lint-imports" --config "$root/pyproject.toml" --no-logo)

exec "$venv/bin/python" -m pytest -n auto --dist loadgroup "$@"
