#!/usr/bin/env bash
# Sets everything up in .venv of this checkout, then runs the tests, and beside them checks style and types.
# Arguments are passed on to pytest, which runs as many processes as there are cores (-n 0: this one alone).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
# Some three hundred processes would each compile our sources and what they import anew.
unset PYTHONDONTWRITEBYTECODE
set_up dev
cd "$root"
export MALLOC_ARENA_MAX=2 # fewer heaps of threads: JAX tests peaked at 0.90 GB in place of 0.99

# Beside compiling and the first tests, as it takes one core for a minute; what it finds stands at the end.
mkdir -p build
bash scripts/lint.sh >build/lint.txt 2>&1 &
lint=$!
trap 'kill "$lint" 2>/dev/null || true' EXIT
see_to_compiling
failed=0
# A file in one process: what its tests share (fixtures, compiled functions and programs) is made once. In conftest.py's order.
"$venv/bin/python" -m pytest -n auto --dist loadfile --no-loadscope-reorder "$@" || failed=$?
if ! wait "$lint"; then
    failed=1
    say "Style, types or imports are wrong:"
    cat build/lint.txt >&2
fi
exit "$failed"
