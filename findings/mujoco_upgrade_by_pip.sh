#!/usr/bin/env bash
# MuJoCo: pip's upgrade from 3.x to 4.0 leaves no MuJoCo. 4.0 is split into parts, whose files pip writes before it removes those of the
# same names of 3.x. pip ends with 0, `pip check` finds nothing, and the import fails.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
python="$folder/venv/bin/python"
tell() { "$python" -c 'from importlib.metadata import version as of; print("mujoco", of("mujoco"), "pip", of("pip"))'; }
cd "$folder"
"$python" -m pip install --quiet mujoco==3.17.0 numpy==2.4.6
tell
"$python" -c 'import mujoco; print("imported:", mujoco.__version__)'
"$python" -m pip install --quiet mujoco==4.0.0
tell
"$python" -m pip check
if "$python" -c 'import mujoco' 2>import.txt; then
    echo "the upgraded package can be imported"
    exit 1
fi
tail -n 3 import.txt
"$python" -m pip install --quiet --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.0 mujoco-studio==4.0.0
"$python" -c 'import mujoco; print("installed again:", mujoco.__version__)'
