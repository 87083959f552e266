"""Scenes from the variables of MATLAB programs: STEDY, MOTES and TsgFEM, by the names that these programs use.

    nodes                N (3, n), N_simple; tData.N
    bars, strings        C_b, C_s (Cb, Cs) with a row of -1 and 1 each, or pairs of node numbers from 1 (C_b_in, ...);
                         C of both with nBar, or with index_b and index_s; P and D of N P = D join or pin nodes
    strings              rest lengths s_0, Lk, strings.rLP (of the length), l0; force densities sigmaEq, sigma, gamma,
                         q, Force_den; stiffness k, K, or E A / L0 of strings.E and strings.r, or of E and A;
                         damping c, damper
    bars                 m, mass, or density times volume of bars.rho and bars.r; radius bars.r, Bradius, r_b
    supports             fixedNodes (3, n), pinned_nodes, Pinned_nodes (node, x, y, z), pinned_X, pinned_Y, pinned_Z
    world                g, W (3, n), Nd0, ms or Mp (point masses), tf or tEnd

Sources: STEDY's Docs/UserGuide.md and Main/tensegGenMat.m (github.com/isrlab/stedy); MOTES' tenseg_struct_gen.m and
tenseg_defaults.m (github.com/ramaniitrgoyal92/Modeling_of_Tensegrity_Structures_MOTES); TsgFEM's main files
(github.com/Muhao-Chen/Tensegrity_Finite_Element_Method_TsgFEM).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.errors import FormatError
from tensegrity_mj.exchange.importing import ALL, AXES, Draft, ImportOptions, unit_of
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.strings import StringLaw

GROUPS = ("bars", "strings")  # structures of STEDY, whose fields have the same names
MOTES_DEFAULTS = {"stiffness": 100.0, "damping": 0.0, "rod_mass": 1.0, "node_mass": 0.1}  # tenseg_defaults.m


class Variables:
    """The numeric variables of a file, fields of structures as "bars.r"; knows which were used."""

    def __init__(self, path: Path, values: Mapping[str, Array], unread: Sequence[str]) -> None:
        self.path, self.values, self.unread = path, dict(values), list(unread)
        self.used: set[str] = set()
        # A program is called with one structure, and other variables may have changed by then.
        heads = (key.rpartition(".")[0] for key in self.values if key.rpartition(".")[2] == "N")
        inputs = ("C_b", "C_s", "Cb", "Cs", "C")
        self.input = next(
            (head for head in heads if head and any(f"{head}.{one}" in self.values for one in inputs)), ""
        )

    def find(self, *names: str) -> tuple[str, Array] | None:
        """The first of these variables that is there: of the structure with N, of its own, or of another structure."""
        for name in names:
            inner = (key for key in self.values if key.endswith(f".{name}") and key.split(".")[-2] not in GROUPS)
            key = next((key for key in (f"{self.input}.{name}", name) if key in self.values), None)
            key = next(inner, None) if key is None and "." not in name else key
            if key is not None and self.values[key].size:
                self.used.add(key)
                numbers = self.values[key].astype(float)
                if not np.isfinite(numbers).all():
                    raise self.wrong(key, "every number must be finite")
                return key, numbers
        return None

    def per_member(self, count: int, of: str, *names: str, among: slice | None = None, total: int = 0) -> Array | None:
        """One value for each of `count` members; of a variable of all `total` members, those `among` them."""
        found = self.find(*names)
        if found is None or count == 0:
            return None
        values = found[1].ravel(order="F")
        if among is not None and values.size == total:
            return values[among]
        if values.size not in (1, count):
            raise self.wrong(found[0], f"{values.size} values; it must have one, or {count}: one a {of}")
        return np.broadcast_to(values, (count,)).astype(float)

    def unused(self) -> list[str]:
        """The variables that were not used, nor another of their name; of a structure with none that was, its name."""
        names = {key.rpartition(".")[2] for key in self.used}
        left = [key for key in self.values if key.rpartition(".")[2] not in names]
        whole = {key.partition(".")[0] for key in left} - {key.partition(".")[0] for key in self.used}
        heads = (key.partition(".")[0] for key in left)
        return list(dict.fromkeys(head if head in whole else key for key, head in zip(left, heads, strict=True)))

    def wrong(self, name: str, what: str) -> FormatError:
        return FormatError(f"{self.path}: {name}: {what}")


def draft_of(variables: Variables, options: ImportOptions) -> Draft:
    """The draft of a program's variables.

    Raises:
        FormatError: for variables that are missing, of another shape, or contradict each other.
    """
    return _Reader(variables, options).draft()


class _Reader:
    def __init__(self, variables: Variables, options: ImportOptions) -> None:
        self.v, self.options = variables, options
        found = variables.find("N") if variables.input else variables.find("N_simple", "N")
        if found is None:
            raise FormatError(
                f"{variables.path}: there is no variable N (3, n) of nodes; read were: {_listed(variables.values)}"
            )
        nodes = found[1]
        if nodes.ndim != 2 or nodes.shape[0] != 3:
            raise variables.wrong(found[0], f"its shape is {nodes.shape}; it must be (3, n), a column a node")
        self.nodes = nodes.T
        self.names = [f"n{row + 1}" for row in range(len(self.nodes))]
        self.simple = found[0].endswith("N_simple")
        self.out = Draft(variables.path.stem, f"MATLAB, {variables.path.name}")
        # MOTES requires resting lengths s_0, and gives defaults to what is left out.
        self.defaults = MOTES_DEFAULTS if variables.find("s_0") and not variables.find("rLP", "Lk") else {}

    def draft(self) -> Draft:
        out, v = self.out, self.v
        bars, strings = self._members()
        out.nodes = dict(zip(self.names, self.nodes.tolist(), strict=True))
        self._join_nodes(bars, strings)
        out.rods = self._rods(bars, len(strings))
        out.strings = self._strings(strings, len(bars))
        self._supports()
        ends = {name for rod in out.rods for name in rod.nodes}
        inner = [name for name in out.nodes if name not in ends and out.held.get(name) != ALL]
        masses = v.per_member(len(inner), "node without a bar", "Mp", "ms")
        masses = self._given("node_mass", masses, len(inner), "point masses (Mp, ms)")
        out.masses = dict(zip(inner, masses.tolist(), strict=True))
        self._world()
        left = v.unused()
        if left:
            out.notes.append(f"variables that are not used: {', '.join(left)}")
        if v.unread:
            out.notes.append(f"not read, as they are no numbers: {', '.join(v.unread)}")
        return out

    def _members(self) -> tuple[IntArray, IntArray]:
        v, found = self.v, []
        for names in (("C_b", "Cb", "C_b_in", "Cb_in"), ("C_s", "Cs", "C_s_in", "Cs_in")):
            one = v.find(*names)
            found.append(None if one is None else self._pairs(*one))
        whole = None if any(one is not None for one in found) else v.find("C")
        if whole is not None:
            pairs, count = self._pairs(*whole), v.find("nBar")
            index = v.find("index_b", "bars.index")
            if count is None and index is None:
                raise v.wrong(whole[0], "which of its rows are bars: give nBar, or index_b")
            rows = np.arange(int(count[1].flat[0])) if count is not None else index[1].ravel().astype(int) - 1  # type: ignore[index]
            if not ((rows >= 0) & (rows < len(pairs))).all():
                raise v.wrong(whole[0], f"its bars are rows {_listed(rows + 1)}, and it has {len(pairs)} rows")
            return pairs[rows], np.delete(pairs, rows, axis=0)
        if found[0] is None and found[1] is None:
            raise FormatError(f"{v.path}: there is no connectivity: none of C_b, C_s, C_b_in, C_s_in, C")
        none = np.zeros((0, 2), np.int64)
        return tuple(none if one is None else one for one in found)  # type: ignore[return-value]

    def _pairs(self, name: str, matrix: Array) -> IntArray:
        """Node rows (m, 2) of the members of a connectivity matrix, or of a list of pairs of node numbers."""
        count = len(self.nodes)
        if matrix.ndim == 2 and matrix.shape[1] == count and np.isin(matrix, (-1, 0, 1)).all():
            ends = [np.argwhere(matrix == sign) for sign in (-1, 1)]
            if all(len(end) == len(matrix) and (end[:, 0] == np.arange(len(matrix))).all() for end in ends):
                return np.column_stack([ends[0][:, 1], ends[1][:, 1]]).astype(np.int64)
            raise self.v.wrong(name, "each row must have one -1, at the node where the member begins, and one 1")
        if matrix.ndim == 2 and matrix.shape[1] == 2 and np.array_equal(matrix, np.round(matrix)):
            if (matrix < 1).any() or (matrix > count).any():
                raise self.v.wrong(
                    name, f"node numbers from {matrix.min():g} to {matrix.max():g}; they must be 1 to {count}"
                )
            return matrix.astype(np.int64) - 1
        raise self.v.wrong(
            name, f"its shape is {matrix.shape}; it must be (m, {count}) of -1, 0 and 1, or (m, 2) of node numbers"
        )

    def _join_nodes(self, bars: IntArray, strings: IntArray) -> None:
        """Join what N P = D of MOTES joins, and hold what it holds: nodes that bars share are two there."""
        found, values = self.v.find("P"), self.v.find("D")
        if self.simple or found is None or values is None or found[1].shape[:1] != (len(self.nodes),):
            return
        P, D = found[1], values[1]
        if P.ndim != 2 or D.shape != (3, P.shape[1]):
            raise self.v.wrong(
                values[0], f"its shape is {D.shape}; for P of shape {P.shape} it must be (3, {P.shape[1:]})"
            )
        joined: dict[int, int] = {}
        weighted: list[tuple[str, dict[int, float]]] = []
        for number, (column, value) in enumerate(zip(P.T, D.T, strict=True), start=1):
            rows = np.flatnonzero(column)
            if len(rows) == 1:
                self.out.held[self.names[rows[0]]] = ALL
            elif len(rows) == 2 and column[rows].sum() == 0 and not value.any():
                first, second = rows.tolist()
                self.out.nodes.pop(self.names[second], None)
                joined[second] = first
                for pairs in (bars, strings):
                    pairs[pairs == second] = first
            else:
                weights = {row: float(column[row]) for row in rows.tolist()}
                weighted.append((f"P{number}", weights))
        for name, weights in weighted:
            nodes: dict[str, float] = {}
            for row, weight in weights.items():
                node = self.names[joined.get(row, row)]
                nodes[node] = nodes.get(node, 0.0) + weight
            nodes = {node: weight for node, weight in nodes.items() if weight}
            for axis in AXES if nodes else "":
                self.out.constraints.append(Constraint(f"{name} {axis}", nodes, unit_of(axis)))

    def _given(self, key: str, values: Array | None, count: int, what: str, needed: bool = True) -> Array:
        """Values of members: the file's, else those of the options, else the program's defaults."""
        if values is not None or count == 0:
            return np.zeros(count) if values is None else values
        chosen, whose = getattr(self.options, key), "the import's options"
        if chosen is None and key in self.defaults:
            chosen, whose = self.defaults[key], "MOTES' default"
        if chosen is None and not needed:
            return np.zeros(count)
        if chosen is None:
            raise FormatError(f"{self.v.path}: it gives no {what}; add --{key.replace('_', '-')}")
        self.out.notes.append(f"the file gives no {what}: {chosen:g}, {whose}")
        return np.full(count, chosen)

    def _rods(self, pairs: IntArray, strings: int) -> list[Rod]:
        v, count, total = self.v, len(pairs), len(pairs) + strings
        lengths = np.linalg.norm(self.nodes[pairs[:, 1]] - self.nodes[pairs[:, 0]], axis=1)
        mine = slice(0, count)
        radii = v.per_member(count, "bar", "bars.r", "Bradius", "r_b", "radius", among=mine, total=total)
        density = v.per_member(count, "bar", "bars.rho", "rho_b")
        masses = v.per_member(count, "bar", "m", "mass", among=mine, total=total)
        area = v.per_member(count, "bar", "A_b", "A", among=mine, total=total)
        if masses is None and density is not None and (area is not None or radii is not None):
            masses = density * (area if area is not None else np.pi * radii**2) * lengths  # type: ignore[operator]
        masses = self._given("rod_mass", masses, count, "masses of bars (m, mass, or bars.rho with bars.r)")
        if radii is None:
            radius = self.options.rod_radius or 0.01
            self.out.notes.append(
                f"the file gives no radius of bars: {radius:g} m; it changes pictures and contact only"
            )
            radii = np.full(count, radius)
        modulus = v.per_member(count, "bar", "bars.E", "E", "Eb", among=mine, total=total)
        strength = v.per_member(count, "bar", "sigmab", "sigma_b")
        rods = []
        for row, (i, j) in enumerate(pairs.tolist()):
            section = None
            if modulus is not None and area is not None:
                limit = None if strength is None else strength[row]
                section = Section(area[row], area[row] ** 2 / (4 * math.pi), modulus[row], limit)
            rods.append(Rod(f"b{row + 1}", (self.names[i], self.names[j]), masses[row], radii[row], section=section))
        if any(rod.section is not None for rod in rods):
            self.out.notes.append(
                "bars are elastic in the program, and rigid in simulations here; statics can use E and A, and "
                "with_elastic_rods() of the structure makes them elastic here"
            )
        return rods

    def _strings(self, pairs: IntArray, bars: int) -> list[String]:
        v, count, total = self.v, len(pairs), len(pairs) + bars
        mine = slice(bars, total)
        lengths = np.linalg.norm(self.nodes[pairs[:, 1]] - self.nodes[pairs[:, 0]], axis=1)
        rest = v.per_member(count, "string", "Lk", "s_0", "l0", among=mine, total=total)
        part = v.per_member(count, "string", "strings.rLP")
        if rest is None and part is not None:
            rest = part * lengths
        force = None
        if rest is None:
            force = v.per_member(count, "string", "sigmaEq", "sigma", "gamma", "q", among=mine, total=total)
            mixed = v.per_member(count, "string", "Force_den", among=slice(0, count), total=total)
            force = mixed if force is None else force
        radius = v.per_member(count, "string", "strings.r", "r_s")
        modulus = v.per_member(count, "string", "strings.E", "E", "Es", among=mine, total=total)
        area = v.per_member(count, "string", "A_s", "A", among=mine, total=total)
        area = np.pi * radius**2 if area is None and radius is not None else area
        stiffness = v.per_member(count, "string", "K", "k")
        if stiffness is None and modulus is not None and area is not None:
            # k = E A / L0; with L0 = L (1 - u/k) this is k = E A / L + u.
            stiffness = (
                modulus * area / rest
                if rest is not None
                else modulus * area / lengths + (0 if force is None else force)
            )
        stiffness = self._given("stiffness", stiffness, count, "stiffness of strings (k, or E with r or A)")
        damping = v.per_member(count, "string", "damper", "c")
        damping = self._given("damping", damping, count, "damping of strings (c, damper)", needed=False)
        if part is not None and damping.any():
            self.out.settings["string_law"] = StringLaw.UNCLIPPED  # STEDY's dampers act on any taut string
        limit = v.per_member(count, "string", "sigmas")
        rho = v.per_member(count, "string", "rho_s")
        weight = v.per_member(count, "string", "mass", among=mine, total=total) if "mass" in v.values else None
        if rho is not None or weight is not None:
            kilos = "" if weight is None else f" ({weight.sum():.4g} kg in all)"
            self.out.notes.append(f"strings have no mass here: theirs{kilos} is left out")
        if force is not None and (force < 0).any():
            row = int(np.argmin(force))
            raise FormatError(
                f"{v.path}: string s{row + 1}: force density {force[row]:g} N/m; strings only pull: it must be >= 0"
            )
        return [
            String(
                f"s{row + 1}",
                (self.names[i], self.names[j]),
                float(stiffness[row]),
                float(damping[row]),
                rest_length=None if rest is None else float(rest[row]),
                force_density=None if force is None else float(force[row]),
                strength=None if limit is None or area is None else float(limit[row] * area[row]),
            )
            for row, (i, j) in enumerate(pairs.tolist())
        ]

    def _supports(self) -> None:
        v, held = self.v, self.out.held
        count = len(self.nodes)

        def hold(name: str, numbers: Array, axes: str) -> None:
            for number in numbers.ravel().tolist():
                if number != int(number) or not 1 <= number <= count:
                    raise v.wrong(name, f"node {number:g}; it must be one of 1 to {count}")
                node = self.names[int(number) - 1]
                held[node] = held.get(node, frozenset()) | frozenset(axes)

        fixed, pinned, rows = v.find("fixedNodes"), v.find("pinned_nodes"), v.find("Pinned_nodes")
        if fixed is not None:
            if fixed[1].shape != (3, count):
                raise v.wrong(fixed[0], f"its shape is {fixed[1].shape}; it must be (3, {count}), as N")
            for row, axis in zip(fixed[1], AXES, strict=True):
                hold(fixed[0], np.flatnonzero(row).astype(float) + 1, axis)
        if pinned is not None:
            hold(pinned[0], pinned[1], AXES)
        if rows is not None:
            if rows[1].ndim != 2 or rows[1].shape[1] != 4:
                raise v.wrong(rows[0], f"its shape is {rows[1].shape}; it must be (m, 4): node, x, y, z")
            for node, *flags in rows[1]:
                hold(rows[0], np.array([node]), "".join(a for a, on in zip(AXES, flags, strict=True) if on))
        for axis in AXES:
            one = v.find(f"pinned_{axis.upper()}")
            if one is not None:
                hold(one[0], one[1], axis)

    def _world(self) -> None:
        v, out, count = self.v, self.out, len(self.nodes)
        gravity, end = v.find("g"), v.find("tf", "tEnd")
        if gravity is not None:
            if gravity[1].size != 3:
                raise v.wrong(gravity[0], f"{gravity[1].size} values; gravity must be three numbers [x; y; z]")
            out.settings["gravity"] = tuple(gravity[1].ravel().tolist())
        if end is not None:
            out.settings["duration"] = float(end[1].flat[0])
        flag = v.find("gravity")
        if flag is not None and flag[1].any():
            out.notes.append(
                "gravity is on in the program, by an argument that is not in its variables: the scene has none"
            )
        for names, what in ((("W",), "forces"), (("Nd0", "Nd"), "velocities")):
            found = v.find(*names)
            if found is None or not found[1].any():
                continue
            if found[1].shape != (3, count):
                raise v.wrong(found[0], f"its shape is {found[1].shape}; {what} of nodes must be (3, {count}), as N")
            rows = zip(self.names, found[1].T.tolist(), strict=True)
            moved = {name: row for name, row in rows if any(row)}
            if what == "forces":
                out.loads = [Load(name, tuple(row)) for name, row in moved.items()]
            else:
                out.velocities = moved


def _listed(values: object) -> str:
    names = [str(one) for one in values][:40]  # type: ignore[attr-defined]
    return ", ".join(names) or "none"
