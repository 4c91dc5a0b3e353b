"""Directives whose content comes from the code: what commands print, outputs, options, the API.

``{run}`` runs shell commands in a folder of the page and shows what they print; a command that
fails stops the build. ``{outputs}``, ``{options}`` and ``{api}`` write reference pages.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, ClassVar

import typer
from docutils import nodes
from docutils.parsers.rst import Parser, directives
from docutils.statemachine import StringList
from docutils.utils import new_document
from sample_logs import write_samples
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

PAGES = ("theory", "errata", "constraints")
#: What has no docstring of its own.
CONSTANTS = {
    "KINDS": "Every kind of machine, by its word in a machine file.",
    "LIBRARY": "Every machine of the library, with typical parameters.",
    "RATINGS": "Speed, torque, inertia, DC link and sample time of the shipped machines' drives.",
    "Source": "What :py:func:`fluxobs.read_log` takes.",
}

_kept: dict[str, list[str]] = {}
_folders: dict[str, tempfile.TemporaryDirectory[str]] = {}


def folder_of(page: str) -> Path:
    """Where the commands of a page run: with the sample logs and machine files in it."""
    if page not in _folders:
        _folders[page] = tempfile.TemporaryDirectory(prefix="fluxobs-docs-")
        write_samples(Path(_folders[page].name))
    return Path(_folders[page].name)


class Run(SphinxDirective):
    """Shell commands, a line each (a trailing \\ continues), and what they print."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "quiet": directives.flag,  # do not show what they print
        "exit": directives.nonnegative_int,  # exit code of the last one
        "lines": directives.nonnegative_int,  # show so many lines of each only
    }

    def run(self) -> list[nodes.Node]:
        folder, shown = folder_of(self.env.docname), []
        commands = "\n".join(self.content).replace("\\\n", "\\\0").split("\n")
        for k, command in enumerate(commands):
            command = command.replace("\0", "\n")
            wanted = self.options.get("exit", 0) if k == len(commands) - 1 else 0
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=folder,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                env=os.environ | {"MAKEFLAGS": "--no-print-directory"},
            )
            if done.returncode != wanted:
                raise self.error(f"{command}: exit code {done.returncode}\n{done.stdout}")
            printed = done.stdout.replace(str(folder) + "/", "").rstrip()
            lines = printed.split("\n")
            most = self.options.get("lines", len(lines))
            if len(lines) > most:
                printed = "\n".join([*lines[:most], "…"])
            shown.append(f"$ {command}" + ("" if "quiet" in self.options else f"\n{printed}"))
        block = nodes.literal_block("", "\n".join(shown).rstrip(), language="console")
        block["classes"] = [] if "quiet" in self.options else ["printed"]
        return [nodes.container("", block, classes=["printed"])]


class Markdown(SphinxDirective):
    """Base of directives that write Markdown."""

    def parsed(self, lines: list[str]) -> list[nodes.Node]:
        node = nodes.Element()
        self.state.nested_parse(StringList(lines, "made"), 0, node)
        return node.children


class Outputs(Markdown):
    """The table of what observers return."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.observers import AdaptiveEstimate, Estimate, ImmersionEstimate
        from fluxobs.observers.outputs import markdown

        table = markdown(
            ("plain", Estimate), ("adaptive", AdaptiveEstimate), ("immersed", ImmersionEstimate)
        )
        table = re.sub(r"docs/(\w+)\.md", r"[\1](/\1.md)", table)
        return self.parsed(table.split("\n"))


class Quantities(Markdown):
    """The table of what can vary in a campaign."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.campaigns.quantities import PARAMETERS, QUANTITIES

        lines = ["| quantity | of a drive that is not varied | meaning |", "|---|---|---|"]
        for name, one in QUANTITIES.items():
            neutral = f"{one.neutral:g} {one.unit}".rstrip()
            lines.append(f"| `{name}` | {neutral} | {one.about} |")
        names = ", ".join(f"`{name}`" for name in PARAMETERS)
        lines.append(f"| {names} | 1 | factor on this parameter of the machine file |")
        return self.parsed(lines)


class Measures(Markdown):
    """The table of a campaign's columns."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.campaigns.columns import LOOP_MEASURES, MEASURES

        lines = ["| column | meaning |", "|---|---|"]
        lines.append("| `number`, `machine`, `observer` | the scenario, and who observed |")
        lines.append("| what varies | as drawn |")
        lines += [f"| `{name}` | {about} |" for name, about in MEASURES.items()]
        lines += [f"| `{name}` | in the loop: {about} |" for name, about in LOOP_MEASURES.items()]
        lines.append("| `failed` | why it could not be simulated |")
        return self.parsed(lines)


class Options(Markdown):
    """A command of the program: its help, as the program itself says it."""

    required_arguments = 1
    optional_arguments = 1  # a command of a group has two words

    def run(self) -> list[nodes.Node]:
        from fluxobs.cli.app import app

        name, command = " ".join(self.arguments), typer.main.get_command(app)
        for word in self.arguments:
            command = command.commands[word]  # type: ignore[attr-defined]
        words = [
            f"[{p.metavar or p.name.upper()}]" if not p.required else (p.metavar or "LOG")
            for p in command.params
            if p.param_type_name == "argument"
        ]
        required = [
            f"{p.opts[0]} {_value(p)}"
            for p in command.params
            if p.param_type_name == "option" and p.required
        ]
        usage = " ".join(["fluxobs", name, *words, *required, "[OPTIONS]"])
        lines = ["```text", usage, "```", "", *inspect.cleandoc(command.help or "").split("\n"), ""]
        for p in command.params:
            if p.name == "help":
                continue
            if p.param_type_name == "argument":
                term = f"`{p.metavar or 'LOG'}`"
            else:
                value = "" if p.is_flag else f" {_value(p)}"
                term = ", ".join(f"`{opt}{value}`" for opt in p.opts)
            default = p.default
            said = default not in (None, False, [], ()) and "efault" not in (p.help or "")
            tail = " Required." if p.required else f" Default `{default}`." if said else ""
            lines += [term, f": {(p.help or '').strip()}{tail}", ""]
        return self.parsed(lines)


def _value(p: Any) -> str:
    """What stands for an option's value; where its type is depends on typer's version."""
    kind: Any = getattr(getattr(p, "type", None), "name", "")
    kind = getattr(getattr(p, "type_descriptor", None), "annotation", kind)
    word = str(getattr(kind, "__name__", kind)).lower()
    kinds = {"path": "PATH", "float": "NUMBER", "int": "NUMBER"}
    return str(p.metavar or next((v for k, v in kinds.items() if word.startswith(k)), "WORD"))


class Api(SphinxDirective):
    """Everything in ``__all__`` of a module; what the top level exports is only linked to."""

    required_arguments = 1
    optional_arguments = 20  # names, where not all of them

    def run(self) -> list[nodes.Node]:
        import fluxobs

        name, *only = self.arguments
        module = importlib.import_module(name)
        names = only or sorted(module.__all__, key=lambda n: _order(getattr(module, n)))
        lines, bodies = [f".. py:currentmodule:: {name}", ""], []
        about: list[str] = []
        for one in names:
            value = getattr(module, one)
            top = name != "fluxobs" and getattr(fluxobs, one, None) is value
            home = "fluxobs" if top else name
            first = _first_sentence(one, value)
            kind = "func" if inspect.isfunction(value) else "obj"
            role = "class" if inspect.isclass(value) else kind
            link = f"``{one}``" if one in CONSTANTS else f":py:{role}:`~{home}.{one}`"
            about += [f"   * - {link}", f"     - {first}"]
            if not top:
                bodies += _body(name, one, value)
        table = [".. list-table::", "   :widths: 30 70", "   :class: api-names", "", *about, ""]
        lines += table + bodies
        return _rst(self, lines)


def _order(value: Any) -> int:
    """Functions first, then classes, then errors, then the rest."""
    if inspect.isfunction(value):
        return 0
    if inspect.isclass(value):
        return 2 if issubclass(value, BaseException) else 1
    return 3


def _rst(directive: SphinxDirective, lines: list[str]) -> list[nodes.Node]:
    """reStructuredText parsed inside a Markdown page."""
    settings = directive.state.document.settings
    document = new_document(directive.state.document["source"], settings)
    document.reporter = directive.state.document.reporter
    Parser().parse("\n".join(lines) + "\n", document)
    return list(document.children)


def _first_sentence(name: str, value: Any) -> str:
    if name in CONSTANTS:
        return CONSTANTS[name]
    text = " ".join(inspect.cleandoc(value.__doc__ or "").split("\n\n")[0].split())
    return _escaped(text.removesuffix("::"))


def _body(module: str, name: str, value: Any) -> list[str]:
    full = f"{module}.{name}"
    if name in CONSTANTS:
        return []
    if inspect.isclass(value):
        lines = [f".. autoclass:: {full}", "   :members:"]
        if issubclass(value, BaseException):
            lines = lines[:1]
        elif any(base.__name__ == "CompiledObserver" for base in value.__mro__):
            lines += ["   :inherited-members:"]
        return [*lines, ""]
    return [f".. autofunction:: {full}", ""]


def _skip(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Pydantic's and equinox's own machinery is no part of the API."""
    if name.startswith("model_") or name in ("parameter_names", "tree_flatten", "tree_unflatten"):
        return True
    return None


def _escaped(text: str) -> str:
    """|x| is a length and (*batch, 2) a shape, no markup; ``code`` stays as it is."""
    parts = re.split(r"(``.*?``)", text)
    return "".join(
        part if k % 2 else re.sub(r"(?<!\\)\||(?<=\()\*(?=\w)", r"\\\g<0>", part)
        for k, part in enumerate(parts)
    )


def _before(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are written for people: what only looks like markup is escaped."""
    if what in ("property", "attribute"):
        # A colon in its first sentence is no type: kept from napoleon.
        _kept[name] = [_escaped(line) for line in lines]
        lines[:] = []
        return
    for k, line in enumerate(lines):
        lines[k] = re.sub(
            r"docs/(\w+)\.md",
            lambda m: f":doc:`/{m[1]}`" if m[1] in PAGES else m[0],
            _escaped(line),
        )


def _after(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Types of attributes are words too: they stand in the text, not as something to look up."""
    if name in _kept:
        lines[:] = _kept.pop(name)
    types = {}
    for line in list(lines):
        if found := re.match(r":vartype ([^:]+): (.*)", line):
            types[found[1]] = found[2]
            lines.remove(line)
    for k, line in enumerate(lines):
        if found := re.match(r":ivar ([^:]+): ?(.*)", line):
            kind = f"({types[found[1]]}) " if types.get(found[1]) else ""
            lines[k] = f":ivar {found[1].replace(', ', ',')}: {kind}{found[2]}"


def _find(app: Sphinx, env: Any, node: Any, content: nodes.Node) -> nodes.Node | None:
    """A reference by a short name, or by where a thing is defined rather than exported.

    What exists in the package but has no place in these pages is named without a link.
    """
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"].lstrip("~.")
    domain = env.get_domain("py")
    parts = target.split(".")
    ends = [".".join(parts[-2:])] if node.get("reftype") in ("meth", "attr") else []
    for end in [*ends, parts[-1]]:
        found = [n for n in domain.objects if n == end or n.endswith("." + end)]
        if found:
            name = min(found, key=len)
            at = domain.objects[name]
            return make_refnode(
                app.builder, node.get("refdoc"), at.docname, at.node_id, content, name
            )
    if node.get("reftype") == "mod":
        with contextlib.suppress(ImportError):
            importlib.import_module(target)
            return content
    known = [m for n, m in sys.modules.items() if n.startswith("fluxobs")]
    return content if any(hasattr(m, parts[-1]) for m in known) else None


def _dashes(app: Sphinx, doctree: nodes.document) -> None:
    """Between a parameter and what it is stands a dash, not two hyphens."""
    for text in list(doctree.findall(nodes.Text)):
        if text == " -- ":
            text.parent.replace(text, nodes.Text(" – "))


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("run", Run)
    app.add_directive("outputs", Outputs)
    app.add_directive("options", Options)
    app.add_directive("quantities", Quantities)
    app.add_directive("measures", Measures)
    app.add_directive("api", Api)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _before, priority=100)
    app.connect("autodoc-process-docstring", _after, priority=900)
    app.connect("missing-reference", _find)
    app.connect("doctree-read", _dashes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
