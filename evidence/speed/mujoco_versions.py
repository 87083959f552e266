"""Load what `export --for VERSION` writes in older releases of MuJoCo, and compare ten steps with today's.

    .venv/bin/python -m evidence.speed.mujoco_versions 2.3.7 3.1.0 3.2.3 3.8.1 3.17.0
    .venv/bin/python -m evidence.speed.mujoco_versions drake

Each release is installed by pip into a folder of its own below the temporary one. A row is a scene, a column a release:
the largest distance [m] of a site after ten steps from where today's MuJoCo has it in the plain file. Of Drake, whose
users add the strings, it is that of the bodies at the start, and the closed loops that it knows.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.exchange import save_mjcf_for
from tensegrity_mj.model.text.sources import pack_names, scene_names

STEPPED = """
import json, pathlib, sys, mujoco, numpy
found = {}
for path in sorted(pathlib.Path(sys.argv[1]).glob("*.xml")):
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(10):
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, row) for row in range(model.nsite)]
        found[path.stem] = dict(zip(names, numpy.array(data.site_xpos).tolist()))
    except Exception as error:
        found[path.stem] = str(error).replace(chr(10), " ")
print(json.dumps(found))
"""
PARSED = """
import json, pathlib, sys
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
found = {}
for path in sorted(pathlib.Path(sys.argv[1]).glob("*.xml")):
    try:
        plant = MultibodyPlant(1e-3)
        (model,) = Parser(plant).AddModels(str(path))
        plant.Finalize()
        context = plant.CreateDefaultContext()
        bodies = [plant.get_body(row) for row in plant.GetBodyIndices(model)]
        places = {one.name(): plant.EvalBodyPoseInWorld(context, one).translation().tolist() for one in bodies}
        places["mass, loops"] = [plant.CalcTotalMass(context), float(plant.num_constraints()), 0.0]
        found[path.stem] = places
    except Exception as error:
        found[path.stem] = str(error).replace(chr(10), " ")
print(json.dumps(found))
"""


def _asked(program: str, folder: Path, packages: Path | None) -> dict[str, dict[str, list[float]] | str]:
    way = {} if packages is None else {"PYTHONPATH": str(packages)}
    done = subprocess.run(
        [sys.executable, "-c", program, str(folder)], env=way, capture_output=True, text=True, check=True
    )
    return dict(json.loads(done.stdout))


def _expected_of_drake(folder: Path) -> dict[str, dict[str, list[float]] | str]:
    import mujoco

    found: dict[str, dict[str, list[float]] | str] = {}
    for path in folder.glob("*.xml"):
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        places = {model.body(row).name: data.xpos[row].tolist() for row in range(1, model.nbody)}
        found[path.stem] = places | {"mass, loops": [float(model.body_mass.sum()), float(model.neq), 0.0]}
    return found


def main(releases: list[str]) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as temporary:
        columns = {}
        for release in ("plain", *releases):
            folder = Path(temporary) / f"{release}-files"
            folder.mkdir()
            for name in (*scene_names(), *pack_names()):
                try:
                    file = folder / f"{name.replace('/', '-')}.xml"
                    save_mjcf_for(tmj.load_scene(name), file, None if release == "plain" else release)
                except OptionError as error:
                    print(f"{name}: {error}")
            packages = Path(temporary) / release
            if release != "plain":
                wanted = ["drake"] if release == "drake" else [f"mujoco=={release}", "numpy<2"]
                pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(packages), *wanted]
                subprocess.run(pip, check=True)
            drake = release == "drake"
            columns[release] = _asked(PARSED if drake else STEPPED, folder, None if release == "plain" else packages)
            plain = _expected_of_drake(folder) if drake else columns["plain"]
            for name, places in columns[release].items():
                expected = plain[name]
                if isinstance(places, str) or isinstance(expected, str):
                    print(f"{release:>8} {name:<20} {places}")
                    continue
                gaps = [np.subtract(place, expected[site]) for site, place in places.items() if site in expected]
                print(f"{release:>8} {name:<20} {np.linalg.norm(gaps, axis=-1).max():.1e} m of {len(gaps)}")


if __name__ == "__main__":
    main(sys.argv[1:])
