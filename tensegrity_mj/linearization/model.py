"""A linear model of a scene about a state: its matrices, modes and files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.basics.dependencies import optional
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.basics.jsontext import plain_values, to_json
from tensegrity_mj.basics.matfile import save_mat
from tensegrity_mj.basics.texts import at_a_glance
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.linearization.chart import Chart, chart_of
from tensegrity_mj.model.elements.element import states_at_start
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from control import StateSpace

FLAT = 1e-10  # of the largest |λ|²: below it, ω² is that of a motion that nothing holds
STILL = 1e-12  # of the largest |λ|: a damping below it is none


@dataclass(frozen=True, eq=False)
class Linearization:
    """A linear model, see `linearization`; n coordinates δ, M strings, N nodes, S states of elements.

    Attributes:
        engine: one line.
        scene: what was linearized.
        time: [s].
        nodes, velocities, rest_lengths: the state, (N, 3), (N, 3), (M,).
        inputs: what B's columns change.
        A: (2n + S, 2n + S); with a law, that of the closed loop.
        B: (2n + S, M), the plant's.
        C: (3N, 2n + S).
        residual: (2n + S,) ẋ at the state: zero at an equilibrium.
        gain: (M, 2n + S) derivative of the law's rest lengths (force densities), or None without a law.
        coordinates: (n,) a name for each δ, such as "rod r1: z1" or "rod r1: b2".
        warnings: what the numbers do not show, such as strings at the edge of slackness.
        states: (S,) a name for each number of the elements' states, such as "elements[0] Maxwell: s1".
    """

    engine: str
    scene: Scene
    time: float
    nodes: Array
    velocities: Array
    rest_lengths: Array
    inputs: Command
    A: Array
    B: Array
    C: Array
    residual: Array
    gain: Array | None
    coordinates: tuple[str, ...]
    warnings: tuple[str, ...]
    states: tuple[str, ...] = ()

    def __repr__(self) -> str:
        largest = np.abs(self.residual[len(self.coordinates) :]).max(initial=0.0)
        rest = "an equilibrium" if self.is_equilibrium else f"no equilibrium: accelerations up to {largest:.3g}"
        law = "without a law" if self.gain is None else "with a law"
        rows = [
            ("linear", f"model of {self.scene.name}, {len(self.A)} numbers of the state, {law}"),
            ("engine", self.engine),
            ("state", f"at t = {self.time:g} s, {rest}"),
            ("inputs", f"{self.B.shape[1]} ({self.inputs.value})"),
        ]
        if self.warnings:
            rows.append(("notes", f"{len(self.warnings)}: {self.warnings[0]}"))
        return at_a_glance(rows)

    @property
    def is_equilibrium(self) -> bool:
        """True where the state is at rest: ẋ is below 1e-9 of that which A gives for a metre or a radian."""
        return bool(np.abs(self.residual).max(initial=0.0) <= 1e-9 * max(np.abs(self.A).max(initial=0.0), 1e-300))

    @property
    def eigenvalues(self) -> Array:
        """Eigenvalues (2n + S,) complex [1/s], by ascending modulus, conjugates with positive imaginary part first."""
        return self._modes()[0]

    @property
    def modes(self) -> Array:
        """Modes (3N, 2n + S) complex: the nodes' motion in each, in the order of `eigenvalues`, its largest entry 1."""
        return self._modes()[1]

    @property
    def frequencies(self) -> Array:
        """Frequencies |λ| / 2π [Hz] of modes that swing or are held, ascending: one a pair, without rigid motions."""
        return np.abs(self._held) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios -Re λ / |λ| of the same modes."""
        return np.asarray(-self._held.real / np.abs(self._held))

    @property
    def _held(self) -> Array:
        """Eigenvalues λ of these modes."""
        values = self.eigenvalues
        return values[(np.abs(values) ** 2 > FLAT * np.abs(values).max(initial=0.0) ** 2) & (values.imag >= 0)]

    def _modes(self) -> tuple[Array, Array]:
        n = len(self.coordinates)
        stiffness, damping = -self.A[n:, :n], -self.A[n:, n:]
        scale = np.sqrt(np.abs(stiffness).max(initial=0.0))
        if not self.states and np.abs(damping).max(initial=0.0) <= STILL * scale:
            # From ω² rather than from ±iω, which are not half as accurate where one mode is far softer than another.
            squares, shapes = np.linalg.eig(stiffness)
            roots = np.sqrt(-squares.astype(complex))
            roots = np.where(roots.imag < 0, -roots, roots)
            values = np.concatenate([roots, roots.conj() if np.isrealobj(squares) else -roots])
            values[n:] = np.where(np.abs(roots.imag) <= STILL * np.abs(roots), -roots, values[n:])
            vectors = np.concatenate([shapes, shapes], axis=1)
            moved = self.C[:, :n] @ vectors
        else:
            values, vectors = np.linalg.eig(self.A)
            moved = self.C @ vectors
        order = np.lexsort((-values.imag, np.round(np.abs(values), 9)))
        moved = moved[:, order]
        if moved.size:
            largest = moved[np.argmax(np.abs(moved), axis=0), np.arange(moved.shape[1])]
            moved = moved / np.where(largest == 0, 1, largest)
        return values[order], moved

    def deviation(self, nodes: ArrayLike, velocities: ArrayLike, states: ArrayLike | None = None) -> Array:
        """Deviation x (2n + S,) of node positions and velocities (N, 3) from the state of this model.

        States (S,) of elements are those of the scene's start by default.
        """
        structure = self.scene.structure
        shape = (len(structure.nodes), 3)
        here = real_array("nodes", nodes, shape, "m", False), real_array("velocities", velocities, shape, "m/s", False)
        delta, rate = self._chart.coordinates(*here)
        start = states_at_start(self.scene.elements, self.scene)
        others = start if states is None else real_array("states", states, start.shape, "", False)
        return np.concatenate([delta, rate - self._rate, others - start])

    @cached_property
    def _chart(self) -> Chart:
        return chart_of(self.scene.structure, self.nodes)

    @cached_property
    def _rate(self) -> Array:
        """Rates δ̇ of the state."""
        return self._chart.coordinates(self.nodes, self.velocities)[1]

    def to_control(self) -> StateSpace:
        """The model as a system of python-control; inputs are strings, outputs "n1_x", with "_" for each "." in names.

        They are differences from the state of this model. A StateSpace has no constant term: about a state that is no
        equilibrium it lacks `residual`, and a warning says so.

        Raises:
            MissingPackageError: where python-control is not installed.
        """
        control = optional("control", "linearize(...).to_control()")
        if not self.is_equilibrium:
            warnings.warn(
                "the state is no equilibrium, and a StateSpace has no constant term: model.residual is not in it",
                stacklevel=2,
            )
        return control.ss(
            *(self.A, self.B, self.C, 0),
            inputs=_signals(string.name for string in self.scene.structure.strings),
            outputs=_signals(f"{node}.{axis}" for node in self.scene.structure.node_names for axis in "xyz"),
            states=_signals([*self.coordinates, *(f"{name} rate" for name in self.coordinates), *self.states]),
            name=self.scene.name.replace(".", "_"),
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything as .json, or its arrays and names as .npz or, for MATLAB, .mat; returns the path.

        Raises:
            OptionError: for another suffix, or a place where no file can be written.
        """
        destination = checked(path, (".npz", ".json", ".mat"), "linear model")
        data = self.to_dict()
        with replacing(destination) as part:
            if destination.suffix.lower() == ".json":
                part.write_text(to_json(data) + "\n", encoding="utf-8")
                return destination
            del data["warnings"], data["gain"]
            data["eigenvalues"] = self.eigenvalues
            if self.gain is not None:
                data["gain"] = self.gain
            if destination.suffix.lower() == ".npz":
                arrays: dict[str, Any] = {key: np.asarray(value) for key, value in data.items()}
                np.savez_compressed(part, **arrays)
            else:
                names = {key: tuple(data.pop(key)) for key in ("coordinates", "states", "strings", "nodes")}
                texts = {key: data.pop(key) for key in ("engine", "scene", "inputs")}
                save_mat(part, {key: np.asarray(value) for key, value in data.items()} | names | texts)
        return destination

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "engine": self.engine,
            "scene": self.scene.name,
            **plain_values(self, "time", "inputs", "coordinates", "states"),
            "strings": [string.name for string in self.scene.structure.strings],
            "nodes": list(self.scene.structure.node_names),
            "positions": self.nodes.tolist(),
            **plain_values(self, "velocities", "rest_lengths", "A", "B", "C", "gain", "residual"),
            "equilibrium": self.is_equilibrium,
            "eigenvalues": [[float(value.real), float(value.imag)] for value in self.eigenvalues],
            **plain_values(self, "frequencies", "damping_ratios", "warnings"),
        }


def _signals(names: Iterable[str]) -> list[str]:
    """Names as python-control takes them: no dot, and each once."""
    legal = [name.replace(".", "_") for name in names]
    return legal if len(set(legal)) == len(legal) else [f"{word} {number + 1}" for number, word in enumerate(legal)]
