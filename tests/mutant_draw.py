"""Which mutants there are: places of the source at which one of Cosmic Ray's operators makes a change that matters.

A mutant is drawn in two steps, first a place and then one of the changes that are possible there, so that a `+`, which
has six, does not count six times as much as a `not`, which has one.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.operators.provider import OperatorProvider

# An operator is replaced by one that takes the same operands: `a << b` of two floats would only raise.
ARITHMETIC = ("Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow")
BITS = ("RShift", "LShift", "BitOr", "BitAnd", "BitXor")
ORDER = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")
# `is` and `==` are left apart, since they say the same of members of an enum.
IDENTITY = ("Is", "IsNot")

OPERATORS = (
    *(f"ReplaceBinaryOperator_{a}_{b}" for family in (ARITHMETIC, BITS) for a, b in permutations(family, 2)),
    *(f"ReplaceComparisonOperator_{a}_{b}" for family in (ORDER, IDENTITY) for a, b in permutations(family, 2)),
    *(f"ReplaceUnaryOperator_Delete_{name}" for name in ("Not", "USub", "Invert")),
    "AddNot",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ExceptionReplacer",
    "NumberReplacer",
    "RemoveDecorator",
    "ZeroIterationForLoop",
)


@dataclass(frozen=True)
class Mutant:
    """One change of one file: ``operator`` applied where it fits for the ``occurrence``-th time."""

    path: str
    operator: str
    occurrence: int
    line: int

    def source(self, text: str) -> str:
        """The file's text with the change made.

        Raises:
            ValueError: The text has no such place.
        """
        changed = mutate_code(text, _operator(self.operator), self.occurrence)
        if changed is None:
            raise ValueError(f"{self.path} has no place {self.occurrence} for {self.operator}")
        return changed


def draw(root: Path, paths: Sequence[str], sample: int, seed: int) -> list[Mutant]:
    """Mutants of some files of a repository, drawn by a seed; fewer where the files do not have as many places.

    Args:
        root: The repository.
        paths: Files, relative to it.
        sample: How many.
        seed: The same seed draws the same mutants of the same text.
    """
    texts = {path: (root / path).read_text(encoding="utf-8") for path in sorted(paths)}
    found = [mutants for path, text in texts.items() for mutants in places(path, text)]
    rng = random.Random(seed)
    rng.shuffle(found)
    drawn: list[Mutant] = []
    for place in found:
        if len(drawn) == sample:
            break
        rng.shuffle(place)
        drawn += next(([mutant] for mutant in place if matters(texts[mutant.path], mutant)), [])
    return drawn


def matters(text: str, mutant: Mutant) -> bool:
    """Whether the mutant is a program, and one whose difference could be seen by running it."""
    try:
        changed = ast.parse(mutant.source(text))
    except SyntaxError:
        return False
    return _gist(changed) != _gist(ast.parse(text))


def places(path: str, text: str) -> Iterator[list[Mutant]]:
    """Every place of a file, each with the mutants that are possible there."""
    nodes = list(ast_nodes(get_ast(text)))
    found: dict[tuple[object, ...], list[Mutant]] = {}
    for name in OPERATORS:
        operator = _operator(name)
        spans = [span for node in nodes if _may_change(node) for span in operator.mutation_positions(node)]
        for occurrence, (start, end) in enumerate(spans):
            found.setdefault((start, end, name.split("_", maxsplit=1)[0]), []).append(
                Mutant(path, name, occurrence, start[0])
            )
    yield from found.values()


def _operator(name: str) -> Operator:
    return OperatorProvider()[name]()


def _may_change(node: Any) -> bool:
    """Whether an operator could change a node of parso; to leave names and strings out halves the search."""
    return node.type not in ("name", "string", "newline", "endmarker")


def _gist(tree: ast.AST) -> str:
    return ast.dump(_Gist().visit(tree))


class _Gist(ast.NodeTransformer):
    """Takes away what no run depends on, or what mypy checks in place of a test.

    Docstrings, annotations, texts for people (f-strings, ``__repr__``, ``__str__``), ``frozen``, ``slots``, ``kw_only``
    and ``eq`` of a dataclass, ``strict`` of a ``zip``, abstract methods, what is imported for type checkers alone.
    """

    def visit_Module(self, node: ast.Module) -> ast.AST:
        return self._without_docstring(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        return self._without_docstring(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST | None:
        if node.name in ("__repr__", "__str__"):
            return None
        node.returns = None
        node.decorator_list = [d for d in node.decorator_list if ast.unparse(d) not in ("abstractmethod", "override")]
        return self._without_docstring(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_arguments(self, node: ast.arguments) -> ast.AST:
        # Whether an argument may be given without its name is for mypy.
        node.args = [*node.posonlyargs, *node.args, *node.kwonlyargs]
        node.defaults = [*node.defaults, *(default or ast.Constant(...) for default in node.kw_defaults)]
        node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return ast.Constant("text")

    def visit_Call(self, node: ast.Call) -> ast.AST:
        left_out = {"dataclass": ("frozen", "slots", "kw_only", "eq"), "zip": ("strict",)}.get(
            ast.unparse(node.func), ()
        )
        node.keywords = [keyword for keyword in node.keywords if keyword.arg not in left_out]
        return self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | None:
        return None if "TYPE_CHECKING" in ast.unparse(node.test) else self.generic_visit(node)

    def _without_docstring(self, node: ast.Module | ast.ClassDef | ast.FunctionDef) -> ast.AST:
        if ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:]
        return self.generic_visit(node)
