#!/usr/bin/env bash
# Drake: the `armature` of a joint in MJCF is dropped without a warning, so that the joint moves more easily than in MuJoCo; and
# a body of two joints gets a part that is called by its name and a digit, which must be the name of no other body.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet drake==1.51.1 mujoco==3.17.0
cat >"$folder/armature.xml" <<'XML'
<mujoco model="armature"><option gravity="0 0 0"/><worldbody><body name="a"><joint name="j" type="slide" armature="5"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>
XML
cat >"$folder/names.xml" <<'XML'
<mujoco model="names"><worldbody><body name="rod1"><joint name="j" type="slide"/><joint name="k" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
<body name="rod10"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>
XML
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import mujoco
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

print("drake", version("drake"), "mujoco", mujoco.__version__)


def read(file):
    plant = MultibodyPlant(1e-3)
    Parser(plant).AddModels(file)
    plant.Finalize()
    return plant


plant = read("armature.xml")
drake = float(plant.CalcMassMatrix(plant.CreateDefaultContext())[0, 0])
model = mujoco.MjModel.from_xml_path("armature.xml")
data = mujoco.MjData(model)
data.qfrc_applied[0] = 6.0
mujoco.mj_forward(model, data)
whole = 6.0 / float(data.qacc[0])
print(f"inertia of a slide of 1 kg with an armature of 5 kg: MuJoCo {whole:g} kg, Drake {drake:g} kg")
assert (round(whole, 9), drake) == (6.0, 1.0)

mujoco.MjModel.from_xml_path("names.xml")
try:
    read("names.xml")
except RuntimeError as error:
    print("bodies rod1 (two joints) and rod10: MuJoCo loads them, Drake:", error)
    assert "already contains a body named 'rod10'" in str(error)
else:
    raise SystemExit("Drake loads them")
PYTHON
