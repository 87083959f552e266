"""Every folder in models/ is complete, its generated files are current, and its scene runs."""

from __future__ import annotations

import importlib.resources
import re
import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.contact import hold_spins
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.text.sources import scene_names
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.recorded import LAW_REPORTS, VARIABLES

MODELS = Path(__file__).resolve().parents[2] / "models"
FOLDERS = sorted(path for path in MODELS.iterdir() if path.is_dir() and path.name not in ("pack", "__pycache__"))
PARTS = ("scene.toml", "scene.xml", "scene.png", "README.md")

every_model = pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.name)


def test_the_folders_are_the_scenes_of_the_package() -> None:
    assert [path.name for path in FOLDERS] == scene_names()
    assert {"prism", "pinned_rod", "tbar"} <= set(scene_names())


@every_model
def test_folders_hold_these_files_and_no_others(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(PARTS)
    packaged = importlib.resources.files("tensegrity_mj.models") / folder.name
    assert all(packaged.joinpath(name).is_file() for name in PARTS)


@every_model
def test_the_scene_has_its_name_and_its_source(folder: Path) -> None:
    scene = tmj.load_scene(folder.name)
    assert scene.name == scene.structure.name == folder.name
    assert len(scene.source) > 20
    text = (folder / "scene.toml").read_text(encoding="utf-8")
    assert scene_to_toml(scene) == text  # written as the package writes it


def _kept(folder: Path) -> str:
    return (folder / "scene.xml").read_text(encoding="utf-8")


@every_model
def test_the_mjcf_is_current(folder: Path) -> None:
    """Numbers may differ by round-off, which other processors make: start velocities come from linear systems."""
    pieces = [re.split(r'[\s"]+', text) for text in (_kept(folder), scene_to_mjcf(tmj.load_scene(folder.name)))]
    remedy = (
        f"models/{folder.name}/scene.xml is not what scene.toml gives; "
        f"run: tensegrity-mj export {folder.name} --out models/{folder.name}/scene.xml"
    )
    assert len(pieces[0]) == len(pieces[1]), remedy
    for kept, made in zip(*pieces, strict=True):
        assert kept == made or float(kept) == pytest.approx(float(made), rel=1e-12, abs=1e-12), remedy


@every_model
def test_plain_mujoco_loads_and_steps_the_mjcf(folder: Path) -> None:
    scene = tmj.load_scene(folder.name)
    # As it lands, strings go slack for a moment, and by itself the model lets their dampers act.
    steps = 200
    texts: list[str] = []
    mujoco.set_mju_user_warning(texts.append)
    try:
        model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
        data = mujoco.MjData(model)
        if model.nkey:  # the start of a scene that starts in motion
            mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data, steps)
    finally:
        mujoco.set_mju_user_warning(None)
    assert texts == []
    assert data.time == pytest.approx(steps * model.opt.timestep, rel=1e-12)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    own = any(len(string.curve) > 1 for string in scene.structure.strings) or scene.structure.constraints
    if own or scene.motions or scene.loads or scene.water or scene.structure.string_law is StringLaw.UNCLIPPED:
        # What moves supports, holds nodes, pulls by curves, flows and lets dampers push is the engine's alone.
        return
    # The very model that the engine steps, so the very same motion: there is no law, and control zero is the design.
    # It is written anew here, since the file's last digits may be those of another processor.
    model = mujoco.MjModel.from_xml_string(scene_to_mjcf(scene))
    hold_spins(model, scene)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, steps)
    mujoco.mj_kinematics(model, data)
    run = tmj.simulate(scene, None, tmj.MuJoCo(model.opt.timestep), duration=steps * model.opt.timestep)
    for name, position in zip(scene.structure.node_names, run.nodes[-1], strict=True):
        np.testing.assert_array_equal(data.site(name).xpos, position)


@every_model
def test_elements_have_the_names_of_the_scene(folder: Path) -> None:
    structure = tmj.load_scene(folder.name).structure
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    strings = [string.name for string in structure.strings]
    assert [model.tendon(i).name for i in range(model.ntendon)] == strings
    assert [model.actuator(i).name for i in range(model.nu)] == strings
    # Where loops are closed, there are sites of the second rods, too.
    sites = {model.site(i).name for i in range(model.nsite)}
    assert sites >= set(structure.nodes)
    assert len(sites) == len(structure.nodes) + model.neq
    for rod in structure.rods:
        assert model.body(rod.name).mass[0] == rod.mass
        assert model.geom(rod.name).type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE


@every_model
@pytest.mark.parametrize("engine", [tmj.MuJoCo(5e-3), tmj.DAE(rtol=1e-8)], ids=["mujoco", "dae"])
def test_runs_are_finite_and_repeat_bit_by_bit(folder: Path, engine: object) -> None:
    scene = tmj.load_scene(folder.name)
    if scene.contact is not None:
        if isinstance(engine, tmj.MuJoCo):
            engine = tmj.MuJoCo(1e-3)  # a landing is over in milliseconds
    elif folder.name == "tower_beam" and isinstance(engine, tmj.MuJoCo):
        engine = tmj.MuJoCo(2.5e-3)  # its strings are so stiff that 4.3 ms is the largest stable step
    law = tmj.controllers.from_scene(scene) if scene.control else None
    duration = 0.3 if law is None else 0.5  # laws move more slowly
    first, second = (tmj.simulate(scene, law, engine, duration=duration) for _ in range(2))  # type: ignore[arg-type]
    assert first.status is tmj.Status.COMPLETED
    for name in VARIABLES:
        values = getattr(first, name)
        np.testing.assert_array_equal(values, getattr(second, name))
        if name not in LAW_REPORTS:
            assert np.all(np.isfinite(values)), name
            assert not np.shares_memory(values, getattr(second, name))
    assert np.abs(first.nodes[-1] - first.nodes[0]).max() > 1e-4  # something happens


@every_model
def test_the_readme_has_what_it_must(folder: Path) -> None:
    text = (folder / "README.md").read_text(encoding="utf-8")
    for part in ("**Source:**", "**Needs:** MuJoCo 4.0", "(scene.png)", "## Where each number comes from", "## Run it"):
        assert part in text
    assert f"tensegrity-mj run {folder.name} " in text
    assert "What to expect:" in text
    scene = tmj.load_scene(folder.name)
    if "thesis" in text or "Wroldsen" in scene.source:
        assert "NTNU 2007:190" in text
        assert scene.source.rpartition("pages ")[2].replace("-", " to ") in text


def test_what_the_readmes_promise() -> None:
    runs = {}
    for name, step in (("prism", 1e-2), ("pinned_rod", 1e-2), ("tbar", 1e-2), ("prism_drop", 5e-4)):
        scene = tmj.load_scene(name)
        law = tmj.controllers.from_scene(scene) if scene.control else None
        runs[name] = tmj.simulate(scene, law, tmj.MuJoCo(step))
    # RK4 at 0.01 s: the figures below have two or three digits, its error is below 1e-5 m.
    prism, rod, bars = runs["prism"], runs["pinned_rod"], runs["tbar"]
    assert prism.target_error()[-1] < 0.005
    assert prism.max_force_density == pytest.approx(0.1545, abs=2e-4)
    assert prism.time[prism.force_densities.max(axis=1).argmax()] == pytest.approx(2.2, abs=0.05)
    assert -0.51 < prism.multipliers.min() < prism.multipliers.max() < 0
    assert prism.rest_lengths.min() > 0.5
    assert rod.target_error()[np.searchsorted(rod.time, 30.0)] == pytest.approx(0.17, abs=5e-3)
    assert rod.target_error()[-1] < 0.02
    assert rod.force_densities[0].max() == pytest.approx(0.080, abs=5e-4)
    assert rod.force_densities[rod.time >= 1].max() < 0.044
    head = bars.nodes[:, 2]
    fallen = np.linalg.norm(head - head[0], axis=1)
    assert fallen.max() == pytest.approx(1.5, abs=0.05)
    assert fallen[np.argmin(np.abs(bars.time - 1.83))] < 0.02
    assert bars.tensions[0, 1] == pytest.approx(94, abs=0.5)
    assert bars.tensions[:, 1].min() == pytest.approx(0.7, abs=0.05)
    assert bars.tensions[:, 2].max() == pytest.approx(112, abs=0.5)
    assert not bars.tensions[:, 0].any()  # between the feet
    drop = runs["prism_drop"]
    touching = np.array(drop.reports["contact"]["touching"])
    assert drop.time[np.argmax(touching > 0)] == pytest.approx(0.25, abs=1e-9)
    hop = drop.time[(touching == 0) & (drop.time > 0.25)]
    assert (hop[0], hop[-1]) == pytest.approx((0.27, 0.27), abs=1e-9)
    assert drop.tensions.min() == 0
    assert drop.tensions.max() == pytest.approx(75.1, abs=0.5)
    assert np.abs(drop.velocities[drop.time >= 1.25]).max() < 1e-4
    assert 0.008 - drop.nodes[-1, :3, 2] == pytest.approx([2.65e-4] * 3, abs=5e-6)
    assert drop.external_work[-1] == pytest.approx(-0.76, abs=0.01)
    assert drop.dissipation[-1] == pytest.approx(1.145, abs=0.01)


@every_model
def test_the_picture_is_small_and_of_the_usual_size(folder: Path) -> None:
    data = (folder / "scene.png").read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (640, 480)
    assert len(data) < 100_000
