#!/usr/bin/env bash
# Sets everything up in .venv of this checkout, then checks style and types and runs the tests.
# Arguments are passed on to pytest, which runs as many processes as there are cores (-n 0: this one alone).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up dev
cd "$root"

bash scripts/lint.sh
exec "$venv/bin/python" -m pytest -n auto --dist loadgroup "$@"
