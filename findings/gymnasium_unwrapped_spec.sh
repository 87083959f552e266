#!/usr/bin/env bash
# Gymnasium: an environment made by its id does not know the episode length that the id was registered with.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet gymnasium==1.4.0
"$folder/venv/bin/python" - <<'PYTHON'
import gymnasium

outer = gymnasium.make("CartPole-v1")
registered, inner = outer.spec.max_episode_steps, outer.unwrapped.spec.max_episode_steps
print(f"gymnasium {gymnasium.__version__}: outermost wrapper {registered} steps, unwrapped environment {inner}")
assert outer.unwrapped.spec.id == "CartPole-v1"
assert registered == 500
assert inner is None
PYTHON
