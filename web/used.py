"""Find the names of the package that the page uses, to leave out unused definitions."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from scopes import assigned, defined, without_docstring


@cache
def names_of(path: Path) -> frozenset[str]:
    """Return the names that a module defines or imports."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return frozenset(assigned(body) | defined(body))


@cache
def models_of(source: Path) -> frozenset[str]:
    """Return the names of the classes whose fields pydantic checks by their annotations."""
    bases: dict[str, set[str]] = {}
    for path in source.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names = {base.id for base in node.bases if isinstance(base, ast.Name)}
                bases.setdefault(node.name, set()).update(names)
    models = {"BaseModel"}
    while more := {name for name, parents in bases.items() if parents & models} - models:
        models |= more
    return frozenset(models)


@cache
def methods_of(source: Path) -> frozenset[str]:
    """Return the names of all methods in the package except properties."""
    names = set()
    for path in source.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                methods = [item for item in node.body if isinstance(item, ast.FunctionDef)]
                names |= {
                    method.name
                    for method in methods
                    if not any("property" in ast.unparse(d) for d in method.decorator_list)
                }
    return frozenset(names)


#: Decorators that do not call the decorated function.
_PLAIN = {"property", "cached_property", "classmethod", "staticmethod", "abstractmethod"}


def used(node: ast.FunctionDef, live: set[str]) -> bool:
    """Whether a method may be used; Python itself calls methods with two underscores."""
    called = any(not isinstance(d, ast.Name) or d.id not in _PLAIN for d in node.decorator_list)
    return node.name in live or node.name.startswith("__") or called


def words_in(body: Iterable[ast.AST], live: set[str] | None = None) -> set[str]:
    """Return names, attributes and words in strings of code, without annotations and imports.

    Of the methods of a class, only those whose names are `live` are searched.
    """
    words: set[str] = set()
    todo = list(body)
    while todo:
        node = todo.pop()
        match node:
            case ast.Import() | ast.ImportFrom():
                continue
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.keyword(arg=str(name)):
                words.add(name)
            case ast.Constant(value=str(text)):
                words |= set(text.replace(".", " ").split())
            case ast.FunctionDef():
                todo += [*node.body, *node.decorator_list, *node.args.defaults]
                todo += [default for default in node.args.kw_defaults if default is not None]
                continue
            case ast.ClassDef():
                todo += [*node.bases, *node.decorator_list]
                for item in without_docstring(node.body):
                    method = isinstance(item, ast.FunctionDef)
                    if not method or live is None or used(item, live):
                        todo.append(item)
                continue
            case ast.AnnAssign():
                todo += [node.target, node.annotation, *([node.value] if node.value else [])]
                continue
        todo += ast.iter_child_nodes(node)
    return words


def live_statements(body: list[ast.stmt], live: set[str], inside: set[str]) -> list[ast.stmt]:
    """Return the statements of a module that define live names or have effects.

    `inside` holds the words of the module; unless it is empty, unused imports are dropped.
    """
    statements: list[ast.stmt] = []
    for statement in body:
        match statement:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names = {name}
            case ast.Assign() | ast.AnnAssign():
                names = assigned([statement])
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases) if inside:
                aliases = [
                    a for a in aliases if (a.asname or a.name.split(".")[0]) in inside | live
                ]
                if aliases:
                    statement.names = aliases
                    statements.append(statement)
                continue
            case _:
                names = set()
        if not names or names & live:
            statements.append(statement)
    return statements


def alive(bodies: Iterable[list[ast.stmt]], roots: set[str]) -> set[str]:
    """Return all words reachable from `roots` by name alone, which may be too many."""
    live = set(roots)
    todo = [statement for body in bodies for statement in without_docstring(body)]
    while True:
        before = len(live)
        for statement in todo:
            match statement:
                case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                    reached = name in live
                case ast.Assign() | ast.AnnAssign():
                    reached = bool(assigned([statement]) & live)
                case ast.Import() | ast.ImportFrom():
                    reached = False
                case _:
                    reached = True
            if reached:
                live |= words_in([statement], live)
        if len(live) == before:
            return live


def called_by_name(trees: Iterable[ast.AST], host: str) -> set[str]:
    """Return the names of functions called with keyword arguments anywhere.

    Only these functions need the names of their arguments at run time.
    """
    names = set(re.findall(r"(\w+)\s*\((?:[^()]|\([^()]*\))*\$kw\(", host))
    for tree in trees:
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name(id="partial"), args=[called, *_]):
                    names |= words_in([called])
                case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), keywords=[_, *_]):
                    names.add(name)
    return names
