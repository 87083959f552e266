#!/usr/bin/env bash
# Sets everything up in .venv of this checkout, then checks style and types and runs the tests.
# Arguments are passed on to pytest, which runs as many processes as there are cores (-n 0: this one alone).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up dev
cd "$root"
# Some three hundred processes would each compile our sources anew.
unset PYTHONDONTWRITEBYTECODE
export MALLOC_ARENA_MAX=2 # fewer heaps of threads: JAX tests peaked at 0.90 GB in place of 0.99

# Beside each other, as compiling takes one core.
bash scripts/lint.sh &
lint=$!
trap 'kill "$lint" 2>/dev/null || true' EXIT
see_to_compiling
wait "$lint"
exec "$venv/bin/python" -m pytest -n auto --dist loadgroup "$@"
