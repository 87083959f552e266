"""Identification by JAX's derivatives, of MuJoCo's data: the Jacobian, coverage, and what has no derivative."""

from __future__ import annotations

import signal
import time
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from caught_mass import bob
from scipy import stats

pytest.importorskip("jax")
pytest.importorskip("diffrax")

import tensegrity_mj as tmj
from tensegrity_mj.commands import doctor
from tensegrity_mj.engines.jax import program
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.errors import IdentificationWarning, OptionError
from tensegrity_mj.runs import Table
from tensegrity_mj.studies import FitOptions, identify, measured
from tensegrity_mj.studies.identification.fitting import Problem, fit
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.predictions import predictions_of
from tensegrity_mj.studies.identification.unknowns import Unknowns

Array = np.ndarray
REST_LENGTH = tmj.Command.REST_LENGTH
DRAWS = 200
SPLIT = 1e-3  # of all seeds that binomial bounds are wide enough for, in each tail


def prism_at_work(duration: float) -> tmj.Scene:
    """The prism on strings of k = 20 N/m, c = 0.5 N s/m, a fifth shorter than they are, so that all stay taut."""
    scene = tmj.load_scene("prism")
    lengths = scene.structure.string_lengths(scene.nodes0)
    strings = tuple(
        replace(one, stiffness=20.0, damping=0.5, force_density=None, rest_length=0.8 * float(length))
        for one, length in zip(scene.structure.strings, lengths, strict=True)
    )
    return scene.with_(
        structure=replace(scene.structure, strings=strings), duration=duration, control=None, target=None
    )


def unknowns_of(scene: tmj.Scene, paths: list[str], seed: int) -> tuple[Unknowns, Array]:
    """Starts up to 15 % beside the truth, of rest lengths 3 %, and the truth."""
    truth = Unknowns.of(scene, paths)
    off = np.where([path.endswith("rest_length") for path in truth.paths], 0.03, 0.15)
    start = truth.start * (1 + off * np.random.default_rng(seed).uniform(-1, 1, len(off)))
    return replace(truth, start=start), truth.start


def with_noise(seen: Observation, seed: int) -> Observation:
    """What was seen, off by as much as is stated of each value."""
    noise = np.random.default_rng(seed).standard_normal(seen.values.shape)
    return replace(seen, values=seen.values + seen.sigma * noise)


def noisy(run: tmj.Trajectory, seed: int) -> Observation:
    moved = run.nodes + 1e-3 * np.random.default_rng(seed).standard_normal(run.nodes.shape)
    table = Table(run.time, tuple(run.scene.structure.node_names), moved)
    return Observation.of(run.scene.structure, measured(table, nodes=1e-3))


def check_coverage(found: list[dict[str, Any]], truth: Array) -> Array:
    """Each parameter's intervals of 95 % hold the truth as often as independent ones do; how often they do."""
    bounds = np.array([[[row["low"], row["high"]] for row in one["parameters"]] for one in found])
    inside = np.sum((bounds[..., 0] < truth) & (truth < bounds[..., 1]), axis=0)
    low, high = stats.binom(len(found), 0.95).ppf([SPLIT / len(truth), 1 - SPLIT / len(truth)])
    assert np.all((low <= inside) & (inside <= high)), (inside, low, high)
    total, degrees = (sum(one[key] for one in found) for key in ("chi_squared", "degrees"))
    assert abs(total - degrees) < 4 * np.sqrt(2 * degrees)  # χ² of all draws together, within 4 of its deviations
    return inside / len(found)


PATHS = [
    "structure.strings[s1,s2,s6].stiffness",
    "structure.strings[s4].stiffness",
    "structure.strings[s9].damping",
    "structure.strings[s5].rest_length",
    "structure.rods[rod2].mass",
]


@pytest.mark.slow
def test_derivatives_are_those_of_differences_and_intervals_cover_the_truth() -> None:
    scene = prism_at_work(0.6)
    run = tmj.simulate(scene, engine="mujoco", timestep=1e-3, output_interval=0.03)
    assert run.tensions.min() > 0
    unknowns, truth = unknowns_of(scene, PATHS, 1)
    clean = Observation.of(
        scene.structure, [measured(run, nodes=1e-3), measured(run, ["s7"], tensions=0.1, lengths=1e-3)]
    )
    by_jax, by_dae = (
        predictions_of(unknowns, clean, engine) for engine in (tmj.JAX(), tmj.DAE(rtol=1e-12, atol=1e-14))
    )
    values = unknowns.start
    # Both engines are within 1e-9 of the exact run.
    assert by_jax.predict(values) == pytest.approx(by_dae.predict(values), abs=1e-8)
    ours, theirs = (one.jacobian(values) * unknowns.sizes for one in (by_jax, by_dae))
    # Of differences of 1e-4 of a size the truncation is 1e-8/6 of a third derivative, (ω t)² = 10³ times the first.
    assert np.all(np.abs(ours - theirs).max(axis=0) < 1e-5 * np.abs(theirs).max(axis=0))

    # The same series, so that what is compiled serves all.
    found = [fit(Problem(by_jax, unknowns, with_noise(clean, seed)), FitOptions()) for seed in range(6)]
    assert all(one["converged"] for one in found)
    check_coverage(found, truth)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("structure.nodes[n1].z", "JAX has no derivative by it; use another engine"),
        ("structure.rods[rod1].radius", "JAX has no derivative by it"),
        ("plant.nodes[n1].z=0.8", "JAX has no derivative by it"),
        ("scene.duration", "JAX has no derivative by it"),
    ],
)
def test_what_has_no_derivative_is_refused_by_name(path: str, message: str) -> None:
    scene = prism_at_work(0.1)
    run = tmj.simulate(scene, engine="dae")
    with pytest.raises(OptionError, match=message) as error:
        identify(scene, run, [path], tmj.JAX())
    assert path.partition("=")[0] in str(error.value)


def test_a_damped_string_that_comes_taut_is_reported() -> None:
    scene, times = bob(2.0, duration=0.5), np.array([0.2, 0.5])
    seen = Observation.of(scene.structure, measured(Table(times, ("bob",), np.zeros((2, 1, 3))), nodes=1.0))
    unknowns = Unknowns.of(scene, ["structure.strings.damping"])
    with pytest.warns(IdentificationWarning, match=r"'string' has a damper and comes taut: .* JAX\(window=2e-3\)"):
        predictions_of(unknowns, seen, tmj.JAX()).jacobian(unknowns.start)
    with warnings.catch_warnings():  # of fixed steps derivatives have a window by themselves
        warnings.simplefilter("error", IdentificationWarning)
        predictions_of(unknowns, seen, tmj.JAX(method="rk4", timestep=2e-3)).jacobian(unknowns.start)


def test_ctrl_c_waits_until_the_derivatives_are_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Raised in the middle, it would end the process while XLA's threads are at work."""
    scene, done, compiled = bob(2.0, duration=0.5), [], program.compiled
    run = tmj.simulate(scene, engine="dae", output_interval=0.5)

    def interrupted(*given: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        done.append(compiled(*given))
        return done[0]

    monkeypatch.setattr(program, "compiled", interrupted)
    monkeypatch.setattr(program, "QUIET", 0.0)
    with pytest.raises(KeyboardInterrupt, match="nothing is kept"):
        identify(scene, run, ["structure.strings.damping"], tmj.JAX(method="rk4", timestep=2e-3))
    assert done
    assert "tensegrity-mj: JAX " in capsys.readouterr().err


def hung() -> tmj.Scene:
    """A mass of 1 kg on a string that stays taut."""
    nodes = {"a": (0.0, 0.0, 1.0), "b": (0.3, 0.0, 0.0)}
    string = tmj.String("s", ("a", "b"), 50.0, rest_length=0.9, damping=1.0)
    return tmj.Scene(tmj.Structure("hung", nodes, (), (string,), ("a",), point_masses=(tmj.PointMass("b", 1.0),)))


def test_one_instant_is_enough_and_versions_are_those_of_jax_too() -> None:
    scene = hung()
    run = tmj.simulate(scene, engine="dae", duration=0.3, output_interval=0.3)
    seen = Table(run.time[1:], tuple(scene.structure.node_names), run.nodes[1:])
    found = identify(scene, measured(seen, ["b"], nodes=1e-3), ["structure.strings[s].stiffness=45"], tmj.JAX())
    # Both engines are within 1e-9 m of the exact run; 50 N/m more or less move the mass by 0.1 m or so.
    assert found.values["structure.strings[s].stiffness"] == pytest.approx(50.0, abs=1e-5)
    assert found.data["versions"]["jax"]
    assert found.data["versions"]["diffrax"]
    assert "jax" not in tmj.simulate(scene, engine="dae", duration=0.1).provenance["versions"]
    assert doctor.probed("jax").works


@pytest.mark.parametrize("hold", [None, tmj.Actuation.hold_rest_length, tmj.Actuation.hold_force_density])
def test_fixed_steps_and_held_laws_see_what_the_dae_sees_between_steps(hold: Any) -> None:
    """Both interpolate samples 1 ms apart alike; steps of 1 ms are off by (ω h)⁴ = 2.5e-9 of what moves."""
    scene = hung()
    law = tmj.engines.ArrayPolicy(lambda p, t, x, v: p["rest"] * (1 - t), {"rest": np.array([0.9])}, REST_LENGTH)
    how = (law, hold(0.01)) if hold else ()
    times = np.array([0.0137, 0.0552, 0.0836])
    table = Table(times, ("b",), np.zeros((3, 1, 3)), tensions={"s": times}, lengths={"s": times})
    seen = Observation.of(scene.structure, measured(table, nodes=1.0, tensions=1.0, lengths=1.0))
    unknowns = Unknowns.of(scene, ["structure.strings[s].stiffness", "structure.point_masses[b].mass"])
    ours, theirs = (
        predictions_of(unknowns, seen, engine, *how) for engine in (tmj.JAX(method="rk4", timestep=1e-3), tmj.DAE())
    )
    values = unknowns.start
    assert ours.predict(values) == pytest.approx(theirs.predict(values), abs=1e-8)
    assert ours.jacobian(values) * unknowns.sizes == pytest.approx(theirs.jacobian(values) * unknowns.sizes, abs=1e-5)


@pytest.mark.study
def test_all_36_parameters_of_a_prism_are_covered_in_200_draws_beside_mujocos_own_toolbox() -> None:
    """k, c and L0 of twelve strings from 3 s at 50 Hz with 1 mm of noise, and `mujoco.sysid` on the first two draws."""
    scene = prism_at_work(3.0)
    run = tmj.simulate(scene, engine="mujoco", timestep=1e-3, output_interval=0.02)
    paths = [f"structure.strings[*].{name}" for name in ("stiffness", "damping", "rest_length")]
    first, truth = unknowns_of(scene, paths, 0)
    begun = time.perf_counter()
    model = predictions_of(first, noisy(run, 0), tmj.JAX())
    model.jacobian(first.start)
    compiled = time.perf_counter() - begun
    found = []
    for seed in range(DRAWS):
        unknowns, _ = unknowns_of(scene, paths, seed)
        found.append(fit(Problem(model, replace(first, start=unknowns.start), noisy(run, seed)), FitOptions()))
        assert found[-1]["converged"]
        if seed % 20 == 19:
            print(
                f"{seed + 1}: {time.perf_counter() - begun:.0f} s, covered {check_coverage(found, truth).mean():.3f}",
                flush=True,
            )
    seconds = (time.perf_counter() - begun - compiled) / DRAWS
    covered = check_coverage(found, truth)
    print(
        f"compiled in {compiled:.0f} s, {seconds:.1f} s a fit; covered {covered.mean():.3f}, least {covered.min():.3f}"
    )
    print(f"condition {found[0]['before']['condition']:.2g}; runs {np.mean([one['runs'] for one in found]):.1f}")
    for seed in range(2):
        begun = time.perf_counter()
        theirs = by_mujocos_toolbox(scene, unknowns_of(scene, paths, seed)[0], noisy(run, seed))
        ours = np.array([(row["value"], row["deviation"]) for row in found[seed]["parameters"]])
        off = np.abs(theirs - ours[:, 0]) / ours[:, 1]
        print(f"mujoco.sysid: {time.perf_counter() - begun:.0f} s, at most {off.max():.2g} deviations beside ours")
        # The same sum of squares of the same data: what is left is where either ends.
        assert off.max() < 0.01


def by_mujocos_toolbox(scene: tmj.Scene, unknowns: Unknowns, seen: Observation) -> Array:
    """Estimates by `mujoco.sysid` of the exported model, of stiffness, damping and rest length of each string."""
    pytest.importorskip("tabulate")
    import mujoco
    from mujoco import sysid

    structure = scene.structure
    spec = mujoco.MjSpec.from_string(scene_to_mjcf(scene))
    for node in structure.node_names:
        spec.add_sensor(
            name=node, type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=node
        )
    model = spec.compile()
    parameters = sysid.ParameterDict()
    count = len(structure.strings)

    def modifier(place: int) -> Any:
        part, number = divmod(place, count)

        def modify(spec: Any, parameter: Any) -> None:
            own = spec.actuators[number]
            value = float(parameter.value[0])
            if part == 0:  # at the rest length that it has
                own.biasprm[0] *= value / own.gainprm[0]
                own.gainprm[0], own.biasprm[1] = value, -value
            elif part == 1:
                own.biasprm[2] = -value
            else:
                own.biasprm[0] = own.gainprm[0] * value

        return modify

    for place, start in enumerate(unknowns.start):
        name = unknowns.names[place]
        bounds = {"min_value": 0.5 * start, "max_value": 2 * start}
        parameters.add(sysid.Parameter(name, nominal=start, modifier=modifier(place), **bounds))
    data = mujoco.MjData(model)
    state = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    values = np.stack([seen.values[seen.series == number] for number in range(len(seen.labels))], axis=1)
    step = model.opt.timestep
    times = np.arange(round(seen.times[-1] / step) + 2) * step
    control = sysid.TimeSeries(times, np.zeros((len(times), model.nu)))
    sequences = sysid.ModelSequences(
        "prism", spec, "seen", state, control, sysid.TimeSeries.from_names(seen.times, values, model)
    )

    def weighed(parameters: Any, predicted: Any, measured: Any, *_: Any, **__: Any) -> Any:
        # A rollout's sensors are those of the beginning of the step that its time is the end of.
        begun = sysid.TimeSeries(predicted.times - step, predicted.data, predicted.signal_mapping)
        at = begun.resample(seen.times).data
        return (at - measured.data).ravel() / 1e-3, sysid.TimeSeries(seen.times, at, measured.signal_mapping), measured

    residual = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=weighed)
    _, result = sysid.optimize(parameters, residual, "mujoco", verbose=False)
    return np.asarray(result.x).ravel()
