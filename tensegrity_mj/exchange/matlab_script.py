"""Data of MATLAB scripts (.m): assignments of numbers and matrices, evaluated here; nothing of a script is run.

What is evaluated: numbers, matrices, + - * / ^ and ', element by element, ranges a:b, parts A(i, j) and A(rows, :),
names that were assigned before, and the functions of `FUNCTIONS`. A variable that is assigned in any other way (by
another function, in a loop, under a condition) is not known from there on, and is listed with its line.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import content_of
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.errors import FormatError, printable
from tensegrity_mj.exchange.importing import Draft, ImportOptions
from tensegrity_mj.exchange.matlab import Variables, draft_of

MOST_BYTES = 1_000_000
MOST_ELEMENTS = 2_000_000  # of a matrix: the connectivity of 1,000 nodes and 2,000 members
MOST_SHOWN = 40

_TOKEN = re.compile(
    r"(?P<number>(?:\d+(?:\.(?![*/^'])\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)"
    r"|(?P<sign>\.\*|\./|\.\^|\.'|[-+*/^'(),;:\[\]])"
    r"|(?P<space>[ \t]+)|(?P<line>\n)"
)
_ASSIGNMENT = re.compile(
    r"\s*(?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)\s*(?P<index>\([^()=]*\))?\s*=(?!=)(?P<value>.*)", re.DOTALL
)
_TEXT = re.compile(r"(?<![\w\])}'.])'(?:[^'\n]|'')*'")  # in quotes, which elsewhere transpose
_SEVERAL = re.compile(r"\s*\[(?P<names>[\w.,~\s]*)\]\s*=(?!=)")
_BLOCK = re.compile(r"\s*(for|parfor|while|if|switch|try|function)\b")
_END = re.compile(r"\s*end\w*\b")


class Unknown(Exception):
    """Part of a script that is no data."""


def read(path: Path, options: ImportOptions) -> Draft:
    """The draft of a script.

    Raises:
        FormatError: for a script that assigns no nodes or no members as data, and as `matlab.draft_of`.
    """
    try:
        text = content_of(path, MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content_of(path, MOST_BYTES).decode("latin-1")
    values, unread = data_of(text)
    try:
        draft = draft_of(Variables(path, values, ()), options)
    except FormatError as error:
        more = f"; not read as data: {'; '.join(unread[:3])}{'; ...' * (len(unread) > 3)}" if unread else ""
        raise FormatError(f"{error}{more}") from None
    if unread:
        draft.notes.append(f"not read, as it is no data: {'; '.join(unread)}")
    return draft


def data_of(text: str) -> tuple[dict[str, Array], list[str]]:
    """The matrices (2-D) that a script assigns, and what it does else, each with its line."""
    values: dict[str, Array] = {}
    unread: list[str] = []
    depth = 0
    for line, statement in _statements(text):
        if _BLOCK.match(statement):
            depth += 1
            unread.append(f"line {line}: {_shortened(statement)}")
        elif _END.match(statement) and depth:
            depth -= 1
        elif (several := _SEVERAL.match(statement)) is not None:
            for name in re.split(r"[,\s]+", several["names"].strip()):
                _forget(values, name)
            unread.append(f"line {line}: {_shortened(statement)}")
        elif (found := _ASSIGNMENT.match(statement)) is not None:
            try:
                if depth:
                    raise Unknown("under a condition or in a loop")
                _assign(values, found)
            except (Unknown, ValueError, IndexError, OverflowError, TypeError, AttributeError, RecursionError) as error:
                _forget(values, found["name"])
                unread.append(f"line {line}: {_shortened(statement)} ({error})")
        elif re.sub(r"^\s*(clc|clear|close|warning|format|hold|global|figure)\b.*", "", statement).strip(" \t\n,;"):
            unread.append(f"line {line}: {_shortened(statement)}")
    return values, unread


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Statements without comments, each with its line; brackets hold lines together, and ... does."""
    begin, depth, held = 1, 0, ""
    for number, line in enumerate(text.replace("\r", "\n" if "\n" not in text else "").split("\n"), 1):
        if not held.strip():
            begin = number
        line, piece = _TEXT.sub("$", line), ""
        for at, letter in enumerate(line):
            if letter == "%" or line.startswith("...", at):
                piece += "\n..." if letter == "." else ""
                break
            depth += (letter in "([{") - (letter in ")]}")
            if letter in ";," and depth <= 0:
                yield begin, held + piece
                held, piece, begin, depth = "", "", number, 0
                continue
            piece += letter
        if piece.endswith("\n..."):
            held += piece.removesuffix("\n...") + " "
        elif depth > 0:
            held += piece + "\n"
        else:
            yield begin, held + piece
            held = ""
    yield begin, held


def _forget(values: dict[str, Array], name: str) -> None:
    """A variable, and the fields of a structure, that are not known from here on."""
    for key in [key for key in values if key == name or key.startswith(f"{name}.")]:
        del values[key]


def _assign(values: dict[str, Array], found: re.Match[str]) -> None:
    value, name = evaluate(found["value"], values), found["name"]
    if value.size > 1000 and sum(one.size for one in values.values()) > 5 * MOST_ELEMENTS:
        raise Unknown("more numbers than are kept")
    if not found["index"]:
        values[name] = value
        return
    if name not in values:
        raise Unknown(f"{name} is not known")
    tree = _tree(f"_R[{_python(found['index'][1:-1])}]")
    inside = tree.slice if isinstance(tree, ast.Subscript) else tree
    whole = values[name].copy()
    places = _places(whole, _Evaluator(values).index(inside.elts if isinstance(inside, ast.Tuple) else [inside]))
    shape = whole[places].shape
    whole[places] = value.reshape(shape) if value.size == int(np.prod(shape)) else value
    values[name] = whole


def _places(array: Array, index: list[Any]) -> Any:
    """Return numpy's index for MATLAB's A(i, j), A(k) and A(rows, :), numbers from 1."""
    if len(index) not in (1, 2):
        raise Unknown(f"{len(index)} indices")
    found = []
    for one, size in zip(index, array.shape if len(index) == 2 else (array.size,), strict=True):
        rows = np.arange(size) if one is None else one.astype(int).ravel() - 1
        if (rows < 0).any() or (rows >= size).any():
            raise Unknown("beyond the matrix")
        found.append(rows)
    return np.ix_(*found) if len(index) == 2 else np.unravel_index(found[0], array.shape, order="F")


def _filled(value: float) -> Callable[..., Array]:
    def made(*sizes: Array) -> Array:
        numbers = [int(one) for size in sizes for one in size.ravel()]
        shape = numbers * 2 if len(numbers) == 1 else numbers
        if len(shape) != 2:
            raise Unknown(f"a matrix of {len(shape)} dimensions")
        if min(shape) < 0 or shape[0] * shape[1] > MOST_ELEMENTS:
            raise Unknown(f"a matrix of {shape[0]} x {shape[1]}")
        return np.full(shape, value)

    return made


def _identity(*sizes: Array) -> Array:
    return np.eye(*_filled(0.0)(*sizes).shape)


def _size(array: Array, axis: Array | None = None) -> Array:
    shape = np.array([array.shape], float)
    return shape if axis is None else shape[:, [int(axis[0, 0]) - 1]]


def _rest_lengths(nodes: Array, pairs: Array, parts: Array) -> Array:
    """Lengths of strings (m, 1) times parts: of each string, one for all, or of those that rows [number, part] name."""
    ends = nodes.T[pairs.astype(int) - 1] if pairs.shape[1] == 2 else None
    if ends is None:
        raise Unknown("a connectivity matrix that is not made of pairs")
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]
    if parts.shape[1] == 2:
        lengths[parts[:, 0].astype(int) - 1] *= parts[:, 1:]
        return lengths
    return lengths * parts.reshape(-1, 1)


# The connectivity matrix of MOTES and TsgFEM is made of pairs of node numbers, which `matlab` takes as they are.
FUNCTIONS: dict[str, Callable[..., Array]] = {
    "ones": _filled(1.0),
    "zeros": _filled(0.0),
    "eye": _identity,
    "size": _size,
    "tenseg_ind2C": lambda pairs, nodes: pairs,
    "tenseg_percent2s0": _rest_lengths,
    **{name: getattr(np, name) for name in ("sqrt", "sin", "cos", "tan", "exp", "abs")},
    **{name: getattr(np, f"arc{name[1:]}") for name in ("asin", "acos", "atan")},
}


def evaluate(text: str, values: Mapping[str, Array]) -> Array:
    """The value (2-D) of an expression; raise Unknown where it is no data."""
    if not text.strip(" \t[]"):
        return np.zeros((0, 0))
    return _Evaluator(values).value(_tree(f"_R[{_python(text)}]"))


def _tree(text: str) -> ast.expr:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # such as of 1if, which is no number and a word
            return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise Unknown("no expression that is read") from None


def _python(text: str) -> str:
    """The expression in Python's grammar: A(i, :) as A[i, :], [1 2; 3 4] as _M[_R[1, 2], _R[3, 4]], ' as .T__."""
    found: list[str] = []
    open_brackets: list[str] = []
    operand = spaced = False  # whether an operand ends here, and whether space follows it
    tokens = [(str(one.lastgroup), one[0]) for one in _TOKEN.finditer(text)]
    if sum(len(token) for _, token in tokens) != len(text):
        raise Unknown("no expression of numbers and names")
    for at, (kind, token) in enumerate(tokens):
        matrix = bool(open_brackets) and open_brackets[-1] == "["
        if kind == "space" or (kind == "line" and not matrix):
            spaced = True
            continue
        after = tokens[at + 1][0] if at + 1 < len(tokens) else ""
        begins = kind in ("number", "name") or token in "([" or (token in "+-" and spaced and after != "space")
        if matrix and operand and spaced and begins:
            found.append(", ")
        called = operand and not spaced and token == "("
        operand = kind in ("number", "name") or token in (")", "]", "'", ".'")
        spaced = False
        if token in "([":
            open_brackets.append("call" if called else token)
            found.append("[" if called else "_M[_R[" if token == "[" else "(")
        elif token in ")]":
            opened = open_brackets.pop() if open_brackets else ""
            found.append({"call": "]", "[": "]]", "(": ")"}.get(opened, ")"))
        elif matrix and (token == ";" or kind == "line"):
            found.append("], _R[")
        else:
            found.append(PYTHON.get(token, token.lower().replace("d", "e") if kind == "number" else token))
    return re.sub(r"(, )?_R\[\s*\](, (?=_R))?", lambda empty: ", " if empty[1] and empty[2] else "", "".join(found))


PYTHON = {"*": "@", ".*": "*", "./": "//", "^": "**", ".^": "**", "'": ".T__", ".'": ".T__"}
OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.FloorDiv: np.divide,
    ast.Div: np.divide,
    ast.Pow: np.power,
}


class _Evaluator:
    def __init__(self, values: Mapping[str, Array]) -> None:
        self.values = values

    def value(self, tree: ast.expr) -> Array:
        match tree:
            case ast.Constant(value=int() | float() as number):
                return np.array([[float(number)]])
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return -self.value(inner)
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self.value(inner)
            case ast.BinOp():
                return self._binary(tree)
            case ast.Attribute(attr="T__", value=inner):
                return self.value(inner).T
            case ast.Name(id="pi") if "pi" not in self.values:
                return np.array([[np.pi]])
            case ast.Name() | ast.Attribute():
                return self._known(ast.unparse(tree))
            case ast.Subscript(value=base, slice=inside):
                return self._part(base, inside.elts if isinstance(inside, ast.Tuple) else [inside])
        raise Unknown("no data")

    def _binary(self, tree: ast.BinOp) -> Array:
        left, right = self.value(tree.left), self.value(tree.right)
        scalar = 1 in (left.size, right.size)
        if isinstance(tree.op, ast.MatMult) and not scalar:
            if left.shape[0] * right.shape[1] > MOST_ELEMENTS:
                raise Unknown("a product that is too large")
            return left @ right
        function = np.multiply if isinstance(tree.op, ast.MatMult) else OPERATORS.get(type(tree.op))
        whole = isinstance(tree.op, ast.Pow) and left.size * right.size > 1
        if function is None or whole or (isinstance(tree.op, ast.Div) and right.size > 1):
            raise Unknown("an operation that is not read")
        if not scalar and left.shape != right.shape:
            raise Unknown(f"matrices of shapes {left.shape} and {right.shape}")
        with np.errstate(all="ignore"):
            return np.asarray(function(left, right))

    def _known(self, name: str) -> Array:
        if name in self.values:
            return self.values[name]
        # Numbers that STEDY's tensegConstruct makes: how many nodes, bars, strings and point masses there are.
        field = name.removeprefix("tData.")
        source = self.values.get({"nNodes": "N", "nBar": "Cb", "nStr": "Cs", "nPm": "Cb"}.get(field, ""))
        if source is None or field == name:
            raise Unknown(f"{name} is not known")
        if field == "nNodes":
            return np.array([[float(source.shape[1])]])
        lone = (source == 0).all(axis=0)
        return np.array([[float(lone.sum() if field == "nPm" else len(source))]])

    def _range(self, tree: ast.expr) -> Array:
        """a:b or a:step:b, which Python has as a slice, or any other expression."""
        if not isinstance(tree, ast.Slice):
            return self.value(tree)
        trees = [one for one in (tree.lower, tree.upper, tree.step) if one is not None]
        if tree.lower is None or tree.upper is None:
            raise Unknown("a range without ends")
        parts = [float(self.value(one)[0, 0]) for one in trees]
        low, step, high = parts if len(parts) == 3 else (parts[0], 1.0, parts[1])
        if not (np.isfinite([low, high, step]).all() and step != 0 and abs((high - low) / step) < MOST_ELEMENTS):
            raise Unknown("a range that is too long")
        return low + step * np.arange(np.floor((high - low) / step * (1 + 1e-12)) + 1).reshape(1, -1)

    def index(self, trees: Sequence[ast.expr]) -> list[Array | None]:
        """Indices; None for a colon alone."""
        whole = [isinstance(tree, ast.Slice) and tree.lower is None and tree.upper is None for tree in trees]
        return [None if every else self._range(tree) for every, tree in zip(whole, trees, strict=True)]

    def _part(self, base: ast.expr, trees: Sequence[ast.expr]) -> Array:
        name = ast.unparse(base)
        if name in ("_R", "_M"):
            parts: list[Array] = []
            size = 0
            for tree in trees:  # checked before they are put together, and before more of them are made
                parts.append(self._range(tree))
                size += parts[-1].size
                if size > MOST_ELEMENTS:
                    raise Unknown("a matrix that is too large")
            return parts[0] if len(parts) == 1 else (np.hstack if name == "_R" else np.vstack)(parts)
        if name in FUNCTIONS and name not in self.values:
            with np.errstate(all="ignore"):
                return np.atleast_2d(FUNCTIONS[name](*self.index(trees)))
        known = self.value(base)
        index = self.index(trees)
        part = known[_places(known, index)]
        if len(index) == 1:
            part = part.reshape((-1, 1) if known.shape[1] == 1 or index[0] is None else (1, -1))
        return part


def _shortened(text: str) -> str:
    line = printable(" ".join(text.replace("$", "'...'").split()))
    return shortened(line, MOST_SHOWN)
