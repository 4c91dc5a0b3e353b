"""What of the package's modules is used, and what their names mean beyond one module."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from scopes import assigned, defined, without_docstring


@cache
def names_of(path: Path) -> frozenset[str]:
    """Names that a module defines or imports."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return frozenset(assigned(body) | defined(body))


@cache
def models_of(source: Path) -> frozenset[str]:
    """Names of the classes whose fields pydantic checks: their annotations mean something."""
    bases: dict[str, set[str]] = {}
    for path in source.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                own = {one.id for one in node.bases if isinstance(one, ast.Name)}
                bases.setdefault(node.name, set()).update(own)
    found = {"BaseModel"}
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    return frozenset(found)


@cache
def methods_of(source: Path) -> frozenset[str]:
    """Names of all methods in the package, properties excepted."""
    out = set()
    for path in source.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                functions = [one for one in node.body if isinstance(one, ast.FunctionDef)]
                out |= {
                    one.name
                    for one in functions
                    if not any("property" in ast.unparse(d) for d in one.decorator_list)
                }
    return frozenset(out)


#: Decorators that do not use what they decorate.
_PLAIN = {"property", "cached_property", "classmethod", "staticmethod", "abstractmethod"}


def used(node: ast.FunctionDef, live: set[str]) -> bool:
    """Whether a method may be used; Python itself uses names with two underscores."""
    called = any(not isinstance(d, ast.Name) or d.id not in _PLAIN for d in node.decorator_list)
    return node.name in live or node.name.startswith("__") or called


def words(body: Iterable[ast.AST], live: set[str] | None = None) -> set[str]:
    """Names, attributes and words in texts of some code, but for its annotations and imports.

    Of classes only what all of them need, and those methods whose names are `live`.
    """
    out: set[str] = set()
    todo = list(body)
    while todo:
        node = todo.pop()
        match node:
            case ast.Import() | ast.ImportFrom():
                continue
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.keyword(arg=str(name)):
                out.add(name)
            case ast.Constant(value=str(text)):
                out |= set(text.replace(".", " ").split())
            case ast.FunctionDef():
                todo += [*node.body, *node.decorator_list, *node.args.defaults]
                todo += [one for one in node.args.kw_defaults if one is not None]
                continue
            case ast.ClassDef():
                todo += [*node.bases, *node.decorator_list]
                for one in without_docstring(node.body):
                    method = isinstance(one, ast.FunctionDef)
                    if not method or live is None or used(one, live):
                        todo.append(one)
                continue
            case ast.AnnAssign():
                todo += [node.target, node.annotation, *([node.value] if node.value else [])]
                continue
        todo += ast.iter_child_nodes(node)
    return out


def kept(body: list[ast.stmt], live: set[str], inside: set[str]) -> list[ast.stmt]:
    """Statements of a module that define something live, or do something; with `inside`, the words
    of the module, only those imports that it uses."""
    out: list[ast.stmt] = []
    for one in body:
        match one:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names = {name}
            case ast.Assign() | ast.AnnAssign():
                names = assigned([one])
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases) if inside:
                aliases = [
                    a for a in aliases if (a.asname or a.name.split(".")[0]) in inside | live
                ]
                if aliases:
                    one.names = aliases
                    out.append(one)
                continue
            case _:
                names = set()
        if not names or names & live:
            out.append(one)
    return out


def alive(bodies: Iterable[list[ast.stmt]], roots: set[str]) -> set[str]:
    """All words that are used, from some that are. By name alone: rather too many than too few."""
    live = set(roots)
    todo = [one for body in bodies for one in without_docstring(body)]
    while True:
        before = len(live)
        for one in todo:
            match one:
                case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                    taken = name in live
                case ast.Assign() | ast.AnnAssign():
                    taken = bool(assigned([one]) & live)
                case ast.Import() | ast.ImportFrom():
                    taken = False
                case _:
                    taken = True
            if taken:
                live |= words([one], live)
        if len(live) == before:
            return live


def called_by_name(trees: Iterable[ast.AST], host: str) -> set[str]:
    """Names of functions that somebody calls with arguments by name; only these need to know the
    names of their arguments."""
    out = set(re.findall(r"(\w+)\s*\((?:[^()]|\([^()]*\))*\$kw\(", host))
    for tree in trees:
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name(id="partial"), args=[called, *_]):
                    out |= words([called])
                case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), keywords=[_, *_]):
                    out.add(name)
    return out
