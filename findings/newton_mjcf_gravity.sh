#!/usr/bin/env bash
# Newton: add_mjcf does not read the gravity of <option>: models fall at 9.81 m/s², whatever stands there. It reads the flag.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet newton==1.8.0 warp-lang==1.19.0 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

import newton

print("newton", version("newton"), "warp-lang", version("warp-lang"))
MODEL = """<mujoco model="m"><option gravity="{}">{}</option><worldbody><body name="a"><freejoint/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom size=".1"/></body></worldbody></mujoco>"""


def gravity(*words):
    Path("model.xml").write_text(MODEL.format(*words))
    builder = newton.ModelBuilder()
    builder.add_mjcf("model.xml")
    return float(builder.finalize(device="cpu").gravity.numpy()[0][2])


none, moon, flag = gravity("0 0 0", ""), gravity("0 0 -1.62", ""), gravity("0 0 0", '<flag gravity="disable"/>')
print(f'gravity="0 0 0": {none:g}, gravity="0 0 -1.62": {moon:g}, with <flag gravity="disable"/>: {flag:g} m/s^2')
assert abs(none + 9.81) < 1e-5 and abs(moon + 9.81) < 1e-5 and flag == 0
PYTHON
