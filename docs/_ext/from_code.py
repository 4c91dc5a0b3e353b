"""Sphinx directives whose content comes from the code: printed texts, outputs, options, API.

``{run}`` runs shell commands in a folder of the page and shows their output; a failing command
stops the build. ``{outputs}``, ``{options}`` and ``{api}`` write reference pages.
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
#: Descriptions of objects that cannot have a docstring.
CONSTANTS = {
    "KINDS": "Every kind of machine, by its name in a machine file.",
    "LIBRARY": "Every machine of the library, with typical parameters.",
    "RATINGS": "Speed, torque, inertia, DC link and sample time of the shipped machines' drives.",
    "Source": "Type of the logs that :py:func:`fluxobs.read_log` accepts.",
}

_kept: dict[str, list[str]] = {}
_folders: dict[str, tempfile.TemporaryDirectory[str]] = {}


def folder_of(page: str) -> Path:
    """Return the folder in which a page's commands run; it holds sample logs and machine files."""
    if page not in _folders:
        _folders[page] = tempfile.TemporaryDirectory(prefix="fluxobs-docs-")
        write_samples(Path(_folders[page].name))
    return Path(_folders[page].name)


class Run(SphinxDirective):
    """Run shell commands, one per line (a trailing \\ continues), and show their output."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "quiet": directives.flag,  # hide the output
        "exit": directives.nonnegative_int,  # expected exit code of the last command
        "lines": directives.nonnegative_int,  # show only the first lines of each output
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
    """Write the table of the observers' outputs."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.observers import AdaptiveEstimate, Estimate, ImmersionEstimate
        from fluxobs.observers.outputs import markdown
        from fluxobs.smoothing.estimate import SmoothedEstimate

        table = markdown(
            ("smoothed", SmoothedEstimate),
            ("plain", Estimate),
            ("adaptive", AdaptiveEstimate),
            ("immersed", ImmersionEstimate),
        )
        table = re.sub(r"docs/(\w+)\.md", r"[\1](/\1.md)", table)
        return self.parsed(table.split("\n"))


class Quantities(Markdown):
    """Write the table of the quantities that a campaign can vary."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.campaigns.quantities import PARAMETERS, QUANTITIES

        lines = ["| quantity | value if not varied | meaning |", "|---|---|---|"]
        for name, one in QUANTITIES.items():
            neutral = f"{one.neutral:g} {one.unit}".rstrip()
            lines.append(f"| `{name}` | {neutral} | {one.about} |")
        names = ", ".join(f"`{name}`" for name in PARAMETERS)
        lines.append(f"| {names} | 1 | factor on this parameter of the machine file |")
        return self.parsed(lines)


def _bits(mask: int) -> str:
    """Return the bits of a mask as numbers: a mark of a phase has three."""
    return ", ".join(str(1 << n) for n in range(mask.bit_length()) if mask >> n & 1)


class Marks(Markdown):
    """Write the table of the marks of a row."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.logs.quality.marks import MARKS

        lines = ["| mark | value | meaning | found by | use |", "|---|---|---|---|---|"]
        for mark in MARKS:
            cells = (mark.name, _bits(mark.bit), mark.meaning, mark.found, mark.use)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        return self.parsed(lines)


class Measures(Markdown):
    """Write the table of a campaign's columns."""

    def run(self) -> list[nodes.Node]:
        from fluxobs.campaigns.columns import LOOP_MEASURES, MEASURES

        lines = ["| column | meaning |", "|---|---|"]
        lines.append(
            "| `number`, `machine`, `observer` | the scenario, its machine and its observer |"
        )
        lines.append("| varied quantities | the drawn values |")
        lines += [f"| `{name}` | {about} |" for name, about in MEASURES.items()]
        lines += [f"| `{name}` | in the loop: {about} |" for name, about in LOOP_MEASURES.items()]
        lines.append("| `failed` | reason why the scenario could not be simulated |")
        return self.parsed(lines)


class Options(Markdown):
    """Write the help of a command as the program prints it."""

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
    """Return the placeholder of an option's value, for the type attributes of any typer version."""
    kind: Any = getattr(getattr(p, "type", None), "name", "")
    kind = getattr(getattr(p, "type_descriptor", None), "annotation", kind)
    word = str(getattr(kind, "__name__", kind)).lower()
    kinds = {"path": "PATH", "float": "NUMBER", "int": "NUMBER"}
    return str(p.metavar or next((v for k, v in kinds.items() if word.startswith(k)), "WORD"))


class Api(SphinxDirective):
    """Document all names in ``__all__`` of a module; names of the top level become links."""

    required_arguments = 1
    optional_arguments = 20  # the names, if not all

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
    """Return the sort key: functions first, then classes, then errors, then other objects."""
    if inspect.isfunction(value):
        return 0
    if inspect.isclass(value):
        return 2 if issubclass(value, BaseException) else 1
    return 3


def _rst(directive: SphinxDirective, lines: list[str]) -> list[nodes.Node]:
    """Parse reStructuredText inside a Markdown page."""
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
    """Omit the internal names of pydantic and equinox."""
    if name.startswith("model_") or name in ("parameter_names", "tree_flatten", "tree_unflatten"):
        return True
    return None


def _escaped(text: str) -> str:
    """Escape |x| (a length) and (*batch, 2) (a shape), which are no markup; keep ``code``."""
    parts = re.split(r"(``.*?``)", text)
    return "".join(
        part if k % 2 else re.sub(r"(?<!\\)\||(?<=\()\*(?=\w)", r"\\\g<0>", part)
        for k, part in enumerate(parts)
    )


def _before(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape text in docstrings that only looks like markup."""
    if what in ("property", "attribute"):
        # napoleon would read a colon in the first sentence as a type.
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
    """Write the types of attributes as text, not as references."""
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
    """Resolve a reference by a short name, or by the place of a definition instead of its export.

    A name that exists in the package but not in these pages becomes text without a link.
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
    """Write a dash, not two hyphens, between a parameter and its description."""
    for text in list(doctree.findall(nodes.Text)):
        if text == " -- ":
            text.parent.replace(text, nodes.Text(" – "))


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("run", Run)
    app.add_directive("outputs", Outputs)
    app.add_directive("options", Options)
    app.add_directive("quantities", Quantities)
    app.add_directive("marks", Marks)
    app.add_directive("measures", Measures)
    app.add_directive("api", Api)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _before, priority=100)
    app.connect("autodoc-process-docstring", _after, priority=900)
    app.connect("missing-reference", _find)
    app.connect("doctree-read", _dashes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
