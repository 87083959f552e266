"""A law of the user's, compiled: `CompiledLaw` makes a numba function what every engine calls without Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, instance, member, state_of
from tensegrity_mj.basics.kinds import text
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED, Command, NativeLaw, check_made_for
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.structure import Structure

_Own, _pack = view_of(
    "CompiledLaw",
    node_count="size",
    segments=("i8", "segment_count", 2),
    ranges=("i8", "string_count", 2),
    parameters=("f8", "parameter_count"),
)


@dataclass(frozen=True, eq=False)
class CompiledLaw:
    """A law from a function that numba can compile.

    The function is called as `function(time, nodes, velocities, string_nodes, parameters, command)`: time [s], node
    positions and velocities (N, 3), the two nodes of each string (M, 2), the parameters, and the array (M,) into which
    it writes its command. Where a string runs through more than two nodes, `string_nodes` is a pair of arrays: the
    nodes of all segments (S, 2), and the first segment of each string and the one behind its last (M, 2). It returns
    True, or False where it has no solution. It must neither keep nor create anything that outlives the call: threads
    may run it at the same time.

    Attributes:
        function: a `numba.njit` function, or a plain one, which is compiled here.
        structure: of what it controls.
        parameters: numbers that it needs, in a flat array.
        command: what it writes.
        discontinuous: why it cannot run continuously, or "".

    Raises:
        OptionError: where numba cannot compile it, or parameters are no finite numbers.
    """

    function: Callable[..., Any]
    structure: Structure
    parameters: ArrayLike = field(default_factory=tuple)
    command: Command = Command.FORCE_DENSITY
    discontinuous: str = ""

    def __post_init__(self) -> None:
        if not callable(self.function) or isinstance(self.function, type):
            raise OptionError(
                f"CompiledLaw: function = {self.function!r}; it must be a function that numba can compile"
            )
        instance("CompiledLaw: structure", self.structure, Structure, "use a Structure (scene.structure)")
        object.__setattr__(self, "structure", self.structure.massless)
        member("CompiledLaw: command", self.command, Command)
        checked("CompiledLaw: discontinuous", self.discontinuous, text())
        try:
            parameters = np.array(self.parameters, float).ravel()
        except (TypeError, ValueError, OverflowError):
            parameters = np.array([np.nan])
        if not np.all(np.isfinite(parameters)):
            raise OptionError(f"CompiledLaw: parameters = {self.parameters!r}; they must be finite numbers")
        object.__setattr__(self, "parameters", parameters)
        _ = self._compiled  # so that what numba has to say is said here

    @cached_property
    def _compiled(self) -> tuple[Any, Any]:
        """The C function, and the function that Python calls."""
        import numba
        from numba.core.errors import NumbaError

        from tensegrity_mj.dynamics.native.numba_cache import adopt
        from tensegrity_mj.dynamics.native.pointers import LAW_SIGNATURE, floats

        given = self.function
        function: Any = given if hasattr(given, "py_func") else numba.njit(error_model="numpy")(given)
        adopt(function)
        through_more = len(self.structure.paths.nodes) > len(self.structure.strings)

        def law(t, nodes, velocities, context, command, report):  # type: ignore[no-untyped-def]
            own = _Own(context)
            x, v = floats(nodes, (own.node_count, 3)), floats(velocities, (own.node_count, 3))
            out = floats(command, own.string_count)
            if through_more:  # known as it is compiled: only one of the two calls is there
                solved = function(t, x, v, (own.segments, own.ranges), own.parameters, out)
            else:
                solved = function(t, x, v, own.segments, own.parameters, out)
            return SOLVED if solved else NO_SOLUTION

        try:
            return numba.cfunc(LAW_SIGNATURE, error_model="numpy")(law), function
        except NumbaError as error:
            text = " ".join(str(error).split())
            raise OptionError(
                f"CompiledLaw: numba cannot compile {getattr(given, '__name__', given)!r}; it must take (time, nodes, "
                f"velocities, string_nodes, parameters, command) and return True or False: {text}"
            ) from error

    def native(self, structure: Structure) -> NativeLaw:
        """The law for a plant with the same nodes and strings.

        Raises:
            OptionError: for any other.
        """
        own = self.structure
        check_made_for(own, structure)
        compiled, _ = self._compiled
        segments, ranges = own.paths.nodes, own.paths.ranges
        packed = _pack(node_count=len(own.nodes), segments=segments, ranges=ranges, parameters=self.parameters)
        return NativeLaw(
            address=compiled.address,
            context=packed.address,
            keep=(self, packed),
            command=self.command,
            discontinuous=self.discontinuous,
            stateless=True,
        )

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """The command (M,) at one state.

        Raises:
            InfeasibleError: where the function returns False.
        """
        own = self.structure
        time, nodes, velocities = state_of(time, nodes, velocities, len(own.nodes))
        command = np.zeros(len(own.strings))
        segments, ranges = np.array(own.paths.nodes), np.array(own.paths.ranges)
        strings = segments if len(segments) == len(ranges) else (segments, ranges)
        if not self._compiled[1](time, nodes, velocities, strings, np.asarray(self.parameters, float), command):
            raise InfeasibleError(f"the law has no solution at t = {time:.6g} s")
        return command

    def describe(self) -> dict[str, Any]:
        """Plain values for the provenance of a run."""
        name = getattr(self.function, "__name__", "compiled")
        return {"law": name, "compiled": True, "parameters": np.asarray(self.parameters, float).tolist()}
