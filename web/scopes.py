"""Names that a piece of Python assigns and defines in its own scope."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence


def targets(node: ast.expr) -> set[str]:
    """Return the names that an assignment to this target binds."""
    return {
        n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    }


def own_nodes(body: Iterable[ast.stmt]) -> Iterable[ast.AST]:
    """Yield all nodes of a scope, without nested functions, classes and lambdas."""
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
    """Return the ids of loop variables in comprehensions, which have their own scope."""
    stores = set()
    for node in own_nodes(body):
        if isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            for generator in node.generators:
                stores |= {id(n) for n in ast.walk(generator.target)}
    return stores


def assigned(body: Sequence[ast.stmt]) -> set[str]:
    """Return the names that a scope assigns."""
    loops = _in_comprehension(body)
    names = set()
    for node in own_nodes(body):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and id(node) not in loops:
            names.add(node.id)
        elif (isinstance(node, ast.ExceptHandler) and node.name) or (
            isinstance(node, ast.MatchAs) and node.name
        ):
            names.add(node.name)
        elif isinstance(node, ast.Import):
            names |= {alias.asname or alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module != "__future__":
            names |= {alias.asname or alias.name for alias in node.names}
    return names


def defined(body: Sequence[ast.stmt]) -> set[str]:
    """Return the names of functions and classes that a scope defines."""
    return {n.name for n in own_nodes(body) if isinstance(n, ast.FunctionDef | ast.ClassDef)}


def nonlocal_names(body: Sequence[ast.stmt]) -> set[str]:
    """Return the names that a scope declares nonlocal."""
    return {name for n in own_nodes(body) if isinstance(n, ast.Nonlocal) for name in n.names}


def is_generator(node: ast.FunctionDef) -> bool:
    """Whether a function yields."""
    return any(isinstance(n, ast.Yield | ast.YieldFrom) for n in own_nodes(node.body))


def always_returns(body: Sequence[ast.stmt]) -> bool:
    """Whether the last statement of a function is a return or raise."""
    return bool(body) and isinstance(body[-1], ast.Return | ast.Raise)


def without_docstring(body: list[ast.stmt]) -> list[ast.stmt]:
    """Return a body without its docstring."""
    first = body[0] if body else None
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        return body[1:] if isinstance(first.value.value, str) else body
    return body
