#!/usr/bin/env bash
# Sets everything up in .venv of this checkout and runs the main job: the prism in both engines, compared and filmed.
# What it calls is compiled when it is first called, which is reported. Options of `tensegrity-mj demo` may follow.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up run
exec "$venv/bin/python" -m tensegrity_mj demo --out "$root/results" "$@"
