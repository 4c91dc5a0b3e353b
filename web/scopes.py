"""What a piece of Python assigns and defines in its own scope."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence


def targets(node: ast.expr) -> set[str]:
    """Names that an assignment to this binds."""
    return {
        n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    }


def walked(body: Iterable[ast.stmt]) -> Iterable[ast.AST]:
    """All nodes of a function's own scope."""
    todo: list[ast.AST] = list(body)
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            continue
        for child in ast.iter_child_nodes(node):
            if isinstance(node, ast.If) and _typing_only(node) and child is not node.test:
                continue
            todo.append(child)


def _typing_only(node: ast.If) -> bool:
    return isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _in_comprehension(body: Iterable[ast.stmt]) -> set[int]:
    """Stores to loop names of comprehensions, which are their own."""
    out = set()
    for node in walked(body):
        if isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            for one in node.generators:
                out |= {id(n) for n in ast.walk(one.target)}
    return out


def assigned(body: Sequence[ast.stmt]) -> set[str]:
    """Names that a scope assigns."""
    apart = _in_comprehension(body)
    out = set()
    for node in walked(body):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and id(node) not in apart:
            out.add(node.id)
        elif (isinstance(node, ast.ExceptHandler) and node.name) or (
            isinstance(node, ast.MatchAs) and node.name
        ):
            out.add(node.name)
        elif isinstance(node, ast.Import):
            out |= {one.asname or one.name.split(".")[0] for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module != "__future__":
            out |= {one.asname or one.name for one in node.names}
    return out


def defined(body: Sequence[ast.stmt]) -> set[str]:
    """Functions and classes that a scope defines."""
    return {n.name for n in walked(body) if isinstance(n, ast.FunctionDef | ast.ClassDef)}


def nonlocal_names(body: Sequence[ast.stmt]) -> set[str]:
    """Names that belong to an outer scope."""
    return {name for n in walked(body) if isinstance(n, ast.Nonlocal) for name in n.names}


def is_generator(node: ast.FunctionDef) -> bool:
    """Whether a function yields."""
    return any(isinstance(n, ast.Yield | ast.YieldFrom) for n in walked(node.body))


def always_returns(body: Sequence[ast.stmt]) -> bool:
    """Whether a function cannot run over its end, as far as its last statement shows."""
    return bool(body) and isinstance(body[-1], ast.Return | ast.Raise)


def without_docstring(body: list[ast.stmt]) -> list[ast.stmt]:
    """A body without the text at its head."""
    first = body[0] if body else None
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        return body[1:] if isinstance(first.value.value, str) else body
    return body
