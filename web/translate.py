"""Translate modules of the package into JavaScript, so that a browser runs the same program.

The page must read logs, prepare runs and word messages exactly as the command line does, in a few
kilobytes. Therefore no line is written twice: this program turns the syntax trees of the modules
into JavaScript. The JavaScript calls `runtime/` where the two languages differ (truth, equality,
array operators, keyword arguments, classes). The program supports the part of Python that the
package uses. Any other construct is an error with file and line.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from scopes import (
    always_returns,
    assigned,
    defined,
    is_generator,
    nonlocal_names,
    targets,
    without_docstring,
)
from used import (
    alive,
    called_by_name,
    live_statements,
    methods_of,
    models_of,
    names_of,
    used,
    words_in,
)

#: Reserved words of JavaScript that can be names in Python.
_RESERVED = """
arguments await case catch const debugger default delete do enum eval export extends function
implements instanceof interface let new null package private protected public static super
switch this throw true false typeof undefined var void
"""
RESERVED = frozenset(_RESERVED.split())
#: Methods of strings, lists and bytes, which the runtime provides.
_METHODS = """
append count decode encode endswith extend find format hex index insert isalpha isdigit isprintable
isspace join lower lstrip partition pop removeprefix removesuffix remove replace reverse rfind
rpartition rsplit rstrip sort split splitlines startswith strip swapcase title translate upper
zfill is_integer copy
"""
METHODS = frozenset(_METHODS.split())
OPERATORS = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.Div: "div",
    ast.FloorDiv: "floordiv",
    ast.Mod: "mod",
    ast.Pow: "pow",
    ast.MatMult: "matmul",
    ast.BitAnd: "and_",
    ast.BitOr: "or_",
    ast.BitXor: "xor",
    ast.LShift: "lshift",
    ast.RShift: "rshift",
}
COMPARISONS = {
    ast.Eq: "eq",
    ast.NotEq: "ne",
    ast.Lt: "lt",
    ast.LtE: "le",
    ast.Gt: "gt",
    ast.GtE: "ge",
    ast.In: "in_",
    ast.NotIn: "notin",
}
#: Built-in names that the runtime defines.
_BUILTINS = """
ArithmeticError BaseException Exception FileNotFoundError IndexError KeyError
NotImplementedError OSError OverflowError StopIteration TypeError UnicodeDecodeError ValueError
ZeroDivisionError KeyboardInterrupt abs all any bool bytes callable chr complex dict enumerate
filter float frozenset getattr hasattr int isinstance issubclass iter len list map max min next
object open ord pow print property classmethod staticmethod range repr reversed round set
setattr slice sorted str sum super tuple type zip
"""
BUILTINS = frozenset(_BUILTINS.split())
#: Modules whose names are used mostly in annotations.
TYPES = ("typing", "numpy.typing", "collections.abc")


class Unknown(SyntaxError):
    """Raised for a construct without a translation."""


class Module:
    """One module of the package.

    Parameters
    ----------
    name : str
        Dotted name.
    source : Path
        Folder of the package.
    path : Path
    modules : set of str
        Names of all modules that are translated or replaced.
    """

    def __init__(self, name: str, source: Path, path: Path, modules: set[str]) -> None:
        self.name, self.source, self.path, self.modules = name, source, path, modules
        self.live: set[str] | None = None  # Words in use; None means all words.
        self.by_name: set[str] | None = (
            None  # Functions called with keyword arguments; None means all.
        )
        self.package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        self.tree = ast.parse(path.read_text(encoding="utf-8"))
        self._temporaries = 0
        self._scopes: list[set[str]] = []
        self._classes: list[str] = []
        self._self: list[str | None] = []
        self._loops: list[str] = []  # labels of loops with an else, for break
        self.imports: set[str] = set()
        self._types: dict[str, str] = {}  # name used in annotations → its import

    # ---- names ---------------------------------------------------------------------------

    def fail(self, node: ast.AST, construct: str) -> Unknown:
        line = getattr(node, "lineno", 0)
        return Unknown(f"{self.path}:{line}: no translation for {construct}")

    def is_defined(self, name: str) -> bool:
        return name in BUILTINS or any(name in scope for scope in self._scopes)

    @staticmethod
    def mangled(name: str) -> str:
        return f"{name}$" if name in RESERVED else name

    def temporary(self) -> str:
        self._temporaries += 1
        return f"$v{self._temporaries}"

    def text(self, live: set[str] | None = None, by_name: set[str] | None = None) -> str:
        """Return the module as JavaScript.

        If `live` is given, only definitions with these names are included. If `by_name` is given,
        only functions with these names get the names of their arguments.
        """
        self.live, self.by_name = live, by_name
        if live is not None:
            self.tree.body = live_statements(self.tree.body, live, set())
            inside = words_in(self.tree.body)
            self.tree.body = live_statements(self.tree.body, live, inside)
        names = assigned(self.tree.body) | defined(self.tree.body)
        self._scopes.append(names | {"__package__", "__name__"})
        self._self.append(None)
        body = self.block(without_docstring(self.tree.body))
        needed = {n for n in self._types if re.search(rf"(?<![\w$]){re.escape(n)}(?![\w$])", body)}
        names -= set(self._types) - needed
        body = "".join([self._types[n] + "\n" for n in sorted(needed)]) + body
        declared = ", ".join(sorted(self.mangled(n) for n in names))
        exported = ", ".join(
            self.mangled(n) if n == self.mangled(n) else f"{n}: {self.mangled(n)}"
            for n in sorted(names)
        )
        let = f"let {declared};\n" if names else ""
        return (
            f"$module({json.dumps(self.name)}, ($m) => {{\n"
            f"const __name__ = {json.dumps(self.name)}, __package__ = {json.dumps(self.package)};\n"
            f"{let}{body}\n"
            f"Object.assign($m, {{{exported}}});\n}});\n"
        )

    # ---- statements ----------------------------------------------------------------------

    def block(self, statements: Iterable[ast.stmt]) -> str:
        return "\n".join(filter(None, (self.statement(node) for node in statements)))

    def statement(self, node: ast.stmt) -> str:
        method = getattr(self, f"do_{type(node).__name__}", None)
        if method is None:
            raise self.fail(node, type(node).__name__)
        return str(method(node))

    def do_Expr(self, node: ast.Expr) -> str:
        if isinstance(node.value, ast.Constant):
            return ""
        return f"{self.expr(node.value)};"

    def do_Pass(self, node: ast.Pass) -> str:
        return ""

    def do_Break(self, node: ast.Break) -> str:
        return f"break {self._loops[-1]};"

    def do_Continue(self, node: ast.Continue) -> str:
        return "continue;"

    def do_Nonlocal(self, node: ast.Nonlocal) -> str:
        return ""

    def do_Assert(self, node: ast.Assert) -> str:
        return f"$assert({self.test(node.test)});"

    def do_Import(self, node: ast.Import) -> str:
        imports = []
        for alias in node.names:
            self.imports.add(alias.name)
            imports.append(
                f"{self.mangled(alias.asname or alias.name.split('.')[0])} = "
                f"$import({json.dumps(alias.name)});"
            )
        return " ".join(imports)

    def absolute(self, node: ast.ImportFrom) -> str:
        if node.level == 0:
            return node.module or ""
        parts = self.package.split(".")
        base = parts[: len(parts) - node.level + 1]
        return ".".join([*base, *([node.module] if node.module else [])])

    def exports(self, package: str, name: str) -> bool:
        """Whether a package defines this name; the definition hides a module of the same name."""
        path = find(self.source, package)
        return path is not None and name in names_of(path)

    def do_ImportFrom(self, node: ast.ImportFrom) -> str:
        source = self.absolute(node)
        if source == "__future__":
            return ""
        imports, members = [], []
        for alias in node.names:
            name = self.mangled(alias.asname or alias.name)
            if source in TYPES:
                self.imports.add(source)
                self._types[name] = f"({{{alias.name}: {name}}} = $import({json.dumps(source)}));"
                continue
            if f"{source}.{alias.name}" in self.modules and not self.exports(source, alias.name):
                self.imports.add(f"{source}.{alias.name}")
                imports.append(f"{name} = $import({json.dumps(f'{source}.{alias.name}')});")
            else:
                members.append(f"{alias.name}: {name}")
        if members:
            self.imports.add(source)
            imports.append(f"({{{', '.join(members)}}} = $import({json.dumps(source)}));")
        return " ".join(imports)

    def do_Assign(self, node: ast.Assign) -> str:
        if len(node.targets) == 1:
            return self.assignment(node.targets[0], self.expr(node.value))
        value = self.temporary()
        return f"const {value} = {self.expr(node.value)}; " + " ".join(
            self.assignment(target, value) for target in node.targets
        )

    def assignment(self, target: ast.expr, value: str) -> str:
        match target:
            case ast.Name(id=name):
                return f"{self.place(name)} = {value};"
            case ast.Attribute(value=of, attr=name):
                return f"{self.expr(of)}.{name} = {value};"
            case ast.Subscript(value=of, slice=index):
                return f"$set({self.expr(of)}, {self.index(index)}, {value});"
            case ast.Tuple(elts=elements) | ast.List(elts=elements):
                names = [self.temporary() for _ in elements]
                starred = [isinstance(element, ast.Starred) for element in elements]
                if any(starred[:-1]):
                    raise self.fail(target, "a starred name that is not the last")
                left = ", ".join(
                    f"...{n}" if star else n for n, star in zip(names, starred, strict=True)
                )
                inner = " ".join(
                    self.assignment(e.value if isinstance(e, ast.Starred) else e, name)
                    for e, name in zip(elements, names, strict=True)
                )
                limit = "Infinity" if any(starred) else str(len(elements))
                return f"{{ const [{left}] = $unpack({value}, {limit}); {inner} }}"
        raise self.fail(target, f"assignment to {type(target).__name__}")

    def place(self, name: str) -> str:
        """Return the JavaScript name of an assigned variable."""
        return self.mangled(name)

    def do_AnnAssign(self, node: ast.AnnAssign) -> str:
        if node.value is None:
            return ""
        return self.assignment(node.target, self.expr(node.value))

    def do_AugAssign(self, node: ast.AugAssign) -> str:
        operator = f"$i{OPERATORS[type(node.op)].rstrip('_')}"
        value = self.expr(node.value)
        match node.target:
            case ast.Name(id=name):
                return f"{self.mangled(name)} = {operator}({self.mangled(name)}, {value});"
            case ast.Attribute(value=of, attr=name):
                place = f"{self.expr(of)}.{name}"
                return f"{place} = {operator}({place}, {value});"
            case ast.Subscript(value=of, slice=index):
                whole, at = self.expr(of), self.index(index)
                return f"$set({whole}, {at}, {operator}($get({whole}, {at}), {value}));"
        raise self.fail(node, "this augmented assignment")

    def do_Delete(self, node: ast.Delete) -> str:
        deletions = []
        for target in node.targets:
            if not isinstance(target, ast.Subscript):
                raise self.fail(node, "del of a name")
            deletions.append(f"$del({self.expr(target.value)}, {self.index(target.slice)});")
        return " ".join(deletions)

    def do_Return(self, node: ast.Return) -> str:
        return "return null;" if node.value is None else f"return {self.expr(node.value)};"

    def do_Raise(self, node: ast.Raise) -> str:
        return "throw $e;" if node.exc is None else f"throw $raised({self.expr(node.exc)});"

    def do_If(self, node: ast.If) -> str:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return ""
        code = f"if ({self.test(node.test)}) {{\n{self.block(node.body)}\n}}"
        if node.orelse:
            code += f" else {{\n{self.block(node.orelse)}\n}}"
        return code

    def do_While(self, node: ast.While) -> str:
        return self.loop(f"while ({self.test(node.test)}) {{\n", node)

    def do_For(self, node: ast.For) -> str:
        item = self.temporary()
        first = self.assignment(node.target, item)
        return self.loop(f"for (const {item} of $iter({self.expr(node.iter)})) {{\n{first}\n", node)

    def loop(self, head: str, node: ast.For | ast.While) -> str:
        """Return a loop; its else block runs unless a break ends the loop."""
        self._loops.append(self.temporary() if node.orelse else "")
        code = f"{head}{self.block(node.body)}\n}}"
        label = self._loops.pop()
        return f"{label}: {{\n{code}\n{self.block(node.orelse)}\n}}" if label else code

    def do_With(self, node: ast.With) -> str:
        opened = []
        head = ""
        for item in node.items:
            name = self.temporary()
            opened.append(name)
            head += f"const {name} = $enter({self.expr(item.context_expr)}); "
            if item.optional_vars is not None:
                head += self.assignment(item.optional_vars, f"{name}.value")
        tail = " ".join(f"{name}.exit();" for name in reversed(opened))
        return f"{{ {head} try {{\n{self.block(node.body)}\n}} finally {{ {tail} }} }}"

    def do_Try(self, node: ast.Try) -> str:
        if node.orelse:
            raise self.fail(node, "try … else")
        code = f"try {{\n{self.block(node.body)}\n}}"
        if node.handlers:
            cases = []
            for handler in node.handlers:
                kind = "BaseException" if handler.type is None else self.expr(handler.type)
                name = f"{self.mangled(handler.name)} = $e; " if handler.name else ""
                cases.append(f"if ($caught($e, {kind})) {{ {name}\n{self.block(handler.body)}\n}}")
            code += f" catch ($e) {{ {' else '.join(cases)} else throw $e; }}"
        if node.finalbody:
            code += f" finally {{\n{self.block(node.finalbody)}\n}}"
        return code

    def do_Match(self, node: ast.Match) -> str:
        subject = self.temporary()
        head, cases = f"const {subject} = {self.expr(node.subject)};\n", []
        for case in node.cases:
            test, bind = self.pattern(case.pattern, subject)
            guard = f" && {self.test(case.guard)}" if case.guard else ""
            bound = f"{bind}\n" if bind else ""
            if bind and guard:
                raise self.fail(node, "a guarded capture")
            cases.append(f"if ({test}{guard}) {{\n{bound}{self.block(case.body)}\n}}")
        return "{ " + head + " else ".join(cases) + " }"

    def pattern(self, node: ast.pattern, subject: str) -> tuple[str, str]:
        match node:
            case ast.MatchValue(value=value):
                return f"$eq({subject}, {self.expr(value)})", ""
            case ast.MatchSingleton(value=value):
                return f"{subject} === {json.dumps(value)}", ""
            case ast.MatchOr(patterns=patterns):
                tests = [self.pattern(alternative, subject) for alternative in patterns]
                return "(" + " || ".join(test for test, _ in tests) + ")", ""
            case ast.MatchAs(pattern=None, name=None):
                return "true", ""
            case ast.MatchAs(pattern=None, name=str(name)):
                return "true", f"{self.mangled(name)} = {subject};"
        raise self.fail(node, f"the pattern {type(node).__name__}")

    # ---- functions -----------------------------------------------------------------------

    def do_FunctionDef(self, node: ast.FunctionDef) -> str:
        value = self.function(node, in_class=False)
        for decorator in reversed(node.decorator_list):
            value = f"{self.expr(decorator)}({value})"
        return f"{self.mangled(node.name)} = {value};"

    def function(self, node: ast.FunctionDef, in_class: bool) -> str:
        arguments = node.args
        positional = [*arguments.posonlyargs, *arguments.args]
        static = any(
            isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list
        )
        first = None
        if in_class and not static:
            first, positional = positional[0].arg, positional[1:]
        names = {a.arg for a in (*positional, *arguments.kwonlyargs)}
        names |= {a.arg for a in (arguments.vararg, arguments.kwarg) if a is not None}
        free = nonlocal_names(node.body)
        local = (assigned(node.body) | defined(node.body)) - names - free
        self._scopes.append(local | names | ({first} if first else set()))
        self._self.append(first if first else self._self[-1])
        defaults = self.defaults(positional, arguments.defaults)
        parameters = [
            self.mangled(a.arg) + (f" = {d}" if d is not None else "")
            for a, d in zip(positional, defaults, strict=True)
        ]
        if arguments.vararg:
            parameters.append(self.mangled(arguments.vararg.arg))
        for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
            value = "" if default is None else f" = {self.expr(default)}"
            parameters.append(self.mangled(argument.arg) + value)
        if arguments.kwarg:
            parameters.append(self.mangled(arguments.kwarg.arg))
        star = "*" if is_generator(node) else ""
        head = f"const {self.mangled(first)} = this; " if first else ""
        if local:
            head += f"let {', '.join(sorted(map(self.mangled, local)))};\n"
        body = self.block(without_docstring(node.body))
        tail = "" if star or always_returns(node.body) else "\nreturn null;"
        self._scopes.pop()
        self._self.pop()
        code = f"function{star} ({', '.join(parameters)}) {{ {head}{body}{tail} }}"
        signature = [a.arg for a in positional]
        signature += [f"*{a.arg}" for a in (arguments.vararg,) if a]
        signature += [f"={a.arg}" for a in arguments.kwonlyargs]
        signature += [f"**{a.arg}" for a in (arguments.kwarg,) if a]
        plain = all(name[0] not in "*=" for name in signature) and not node.name.startswith("__")
        if plain and self.by_name is not None and node.name not in self.by_name:
            return f"$def({code})"
        return f"$def({code}, {json.dumps(' '.join(signature))})"

    def defaults(self, names: Sequence[ast.arg], values: Sequence[ast.expr]) -> list[str | None]:
        missing = len(names) - len(values)
        return [None] * missing + [self.expr(value) for value in values]

    # ---- classes -------------------------------------------------------------------------

    def do_ClassDef(self, node: ast.ClassDef) -> str:
        bases = ", ".join(self.expr(base) for base in node.bases)
        members, annotations = [], []
        checked = node.name in models_of(self.source)
        earlier: set[str] = set()  # members so far
        self._classes.append(node.name)
        for item in without_docstring(node.body):
            match item:
                case ast.FunctionDef() if self.live is not None and not used(item, self.live):
                    pass
                case ast.FunctionDef(name=name):
                    value = self.function(item, in_class=True)
                    for decorator in reversed(item.decorator_list):
                        value = f"{self.expr(decorator)}({value})"
                    members.append(f"$c.{name} = {value};")
                    earlier.add(name)
                case ast.AnnAssign(target=ast.Name(id=name), annotation=note, value=value):
                    is_field = "ClassVar" not in ast.unparse(note)
                    if is_field and checked:
                        annotations.append(f"{name}: () => {self.expr(note)}")
                    elif is_field:
                        annotations.append(name)
                    if value is not None:
                        members.append(f"$c.{name} = {self.in_class(value, earlier)};")
                        earlier.add(name)
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    members.append(f"$c.{name} = {self.in_class(value, earlier)};")
                    earlier.add(name)
                case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Pass():
                    pass
                case _:
                    raise self.fail(item, f"{type(item).__name__} in a class")
        self._classes.pop()
        body = "\n".join(members)
        notes = f"{{{', '.join(annotations)}}}" if checked else json.dumps(" ".join(annotations))
        value = f"$class({json.dumps(node.name)}, [{bases}], ($c) => {{\n{body}\n}}, {notes})"
        name = self.mangled(node.name)
        code = f"{name} = {value};"
        for decorator in reversed(node.decorator_list):
            code += f" {name} = {self.expr(decorator)}({name});"
        return code

    def in_class(self, value: ast.expr, earlier: set[str]) -> str:
        """Return an expression that may use earlier members of the class."""
        names = {n.id for n in ast.walk(value) if isinstance(n, ast.Name)} & earlier
        if not names:
            return self.expr(value)
        self._scopes.append(names)
        code = self.expr(value)
        self._scopes.pop()
        bound = ", ".join(sorted(names))
        return f"(({{{bound}}}) => {code})($c)"

    # ---- expressions ---------------------------------------------------------------------

    def expr(self, node: ast.expr) -> str:
        method = getattr(self, f"on_{type(node).__name__}", None)
        if method is None:
            raise self.fail(node, type(node).__name__)
        return str(method(node))

    def test(self, node: ast.expr) -> str:
        """Return an expression as a JavaScript condition."""
        match node:
            case ast.BoolOp(op=ast.And(), values=values):
                return "(" + " && ".join(map(self.test, values)) + ")"
            case ast.BoolOp(op=ast.Or(), values=values):
                return "(" + " || ".join(map(self.test, values)) + ")"
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!{self.test(operand)}"
            case ast.Compare(ops=[ast.Is() | ast.IsNot() | ast.In() | ast.NotIn()]):
                return self.expr(node)
            case ast.Call(func=ast.Name(id="isinstance" | "any" | "all" | "hasattr")):
                return self.expr(node)
        return f"$t({self.expr(node)})"

    def on_Constant(self, node: ast.Constant) -> str:
        value = node.value
        if value is None or value is True or value is False:
            return json.dumps(value)
        if value is Ellipsis:
            return "$ellipsis"
        if isinstance(value, complex):
            return f"$complex(0, {value.imag!r})"
        if isinstance(value, bytes):
            return f"$bytes({json.dumps(list(value))})"
        if isinstance(value, str):
            return json.dumps(value, ensure_ascii=False)
        return repr(value)

    def on_Name(self, node: ast.Name) -> str:
        if not self.is_defined(node.id):
            raise self.fail(node, f"the name {node.id}, which is not defined")
        return self.mangled(node.id)

    def on_Attribute(self, node: ast.Attribute) -> str:
        if node.attr == "__name__":
            return f"$name({self.expr(node.value)})"
        if node.attr in methods_of(self.source):  # a bound method keeps its object
            return f"$bound({self.expr(node.value)}, {json.dumps(node.attr)})"
        return f"{self.expr(node.value)}.{node.attr}"

    def on_JoinedStr(self, node: ast.JoinedStr) -> str:
        pieces = []
        for piece in node.values:
            match piece:
                case ast.Constant(value=str(value)):
                    pieces.append(json.dumps(value, ensure_ascii=False))
                case ast.FormattedValue(value=value, conversion=conversion, format_spec=spec):
                    code = self.expr(value)
                    code = f"repr({code})" if conversion == ord("r") else code
                    if spec is None:
                        pieces.append(f"str({code})")
                    else:
                        pieces.append(f"$format({code}, {self.expr(spec)})")
        return "(" + " + ".join(['""', *pieces]) + ")"

    def sequence(self, elements: Iterable[ast.expr]) -> str:
        return ", ".join(
            f"...$iter({self.expr(element.value)})"
            if isinstance(element, ast.Starred)
            else self.expr(element)
            for element in elements
        )

    def on_Tuple(self, node: ast.Tuple) -> str:
        return f"$tuple([{self.sequence(node.elts)}])"

    def on_List(self, node: ast.List) -> str:
        return f"[{self.sequence(node.elts)}]"

    def on_Set(self, node: ast.Set) -> str:
        return f"set([{self.sequence(node.elts)}])"

    def on_Dict(self, node: ast.Dict) -> str:
        items = []
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                items.append(f"...$items({self.expr(value)})")
            else:
                items.append(f"[{self.expr(key)}, {self.expr(value)}]")
        return f"$dict([{', '.join(items)}])"

    def on_IfExp(self, node: ast.IfExp) -> str:
        return f"({self.test(node.test)} ? {self.expr(node.body)} : {self.expr(node.orelse)})"

    def on_BoolOp(self, node: ast.BoolOp) -> str:
        word = "$and" if isinstance(node.op, ast.And) else "$or"
        *values, code = map(self.expr, node.values)
        for value in reversed(values):
            code = f"{word}({value}, () => {code})"
        return code

    def on_UnaryOp(self, node: ast.UnaryOp) -> str:
        match node.op:
            case ast.Not():
                return f"!{self.test(node.operand)}"
            case ast.USub():
                if isinstance(node.operand, ast.Constant) and not isinstance(
                    node.operand.value, complex
                ):
                    return f"-{node.operand.value!r}"
                return f"$neg({self.expr(node.operand)})"
            case ast.Invert():
                return f"$invert({self.expr(node.operand)})"
        return f"$pos({self.expr(node.operand)})"

    def on_BinOp(self, node: ast.BinOp) -> str:
        word = OPERATORS[type(node.op)]
        return f"${word}({self.expr(node.left)}, {self.expr(node.right)})"

    def on_Compare(self, node: ast.Compare) -> str:
        if len(node.ops) == 1:
            return self.comparison(
                node.ops[0], node.left, node.comparators[0], self.expr(node.left)
            )
        # In a < b < c, b is evaluated once.
        links, left_node, left = [], node.left, self.expr(node.left)
        bound = []
        for op, right in zip(node.ops, node.comparators, strict=True):
            name = self.temporary()
            bound.append(f"const {name} = {self.expr(right)};")
            links.append((" ".join(bound), self.comparison_of(op, left, name, left_node, right)))
            bound, left, left_node = [], name, right
        steps = "".join(f"{b} if (!$t({c})) return false; " for b, c in links[:-1])
        last_bound, last = links[-1]
        return f"(() => {{ {steps}{last_bound} return {last}; }})()"

    def comparison(self, op: ast.cmpop, left: ast.expr, right: ast.expr, text: str) -> str:
        return self.comparison_of(op, text, self.expr(right), left, right)

    def comparison_of(
        self, op: ast.cmpop, left: str, right: str, left_node: ast.expr, right_node: ast.expr
    ) -> str:
        if isinstance(op, ast.Is | ast.IsNot):
            none = isinstance(right_node, ast.Constant) and right_node.value is None
            sign = "=" if isinstance(op, ast.Is) else "!"
            if none:
                return f"({left} {sign}= null)"
            return f"({left} {sign}== {right})"
        return f"${COMPARISONS[type(op)]}({left}, {right})"

    def on_Call(self, node: ast.Call) -> str:
        match node.func:
            case ast.Name(id="super") if not node.args:
                raise self.fail(node, "super() that is not super().name")
            case ast.Attribute(value=ast.Call(func=ast.Name(id="super"), args=[]), attr=name):
                owner, first = self._classes[-1], self._self[-1]
                return f"$super({owner}, {first}, {json.dumps(name)})({self.arguments(node)})"
            case ast.Attribute(value=of, attr=name) if name in METHODS:
                arguments = self.arguments(node)
                comma = ", " if arguments else ""
                return f"$call({self.expr(of)}, {json.dumps(name)}{comma}{arguments})"
            case ast.Attribute(value=of, attr=name) if name != "__name__":
                return f"{self.expr(of)}.{name}({self.arguments(node)})"
        return f"{self.expr(node.func)}({self.arguments(node)})"

    def arguments(self, node: ast.Call) -> str:
        values = [self.sequence([argument]) for argument in node.args]
        if node.keywords:
            named = ", ".join(
                f"...$named({self.expr(k.value)})"
                if k.arg is None
                else f"{json.dumps(k.arg)}: {self.expr(k.value)}"
                for k in node.keywords
            )
            values.append(f"$kw({{{named}}})")
        return ", ".join(values)

    def on_Subscript(self, node: ast.Subscript) -> str:
        return f"$get({self.expr(node.value)}, {self.index(node.slice)})"

    def index(self, node: ast.expr) -> str:
        match node:
            case ast.Slice(lower=low, upper=high, step=step):
                bounds = [("null" if b is None else self.expr(b)) for b in (low, high, step)]
                return f"slice({', '.join(bounds)})"
            case ast.Tuple(elts=elements):
                return f"$tuple([{', '.join(map(self.index, elements))}])"
        return self.expr(node)

    def on_Slice(self, node: ast.Slice) -> str:
        return self.index(node)

    def on_Starred(self, node: ast.Starred) -> str:
        raise self.fail(node, "a starred expression here")

    def on_Lambda(self, node: ast.Lambda) -> str:
        names = [a.arg for a in node.args.args]
        if node.args.vararg or node.args.kwonlyargs or node.args.kwarg:
            raise self.fail(node, "a lambda with such parameters")
        defaults = self.defaults(node.args.args, node.args.defaults)
        self._scopes.append(set(names))
        body = self.expr(node.body)
        self._scopes.pop()
        parameters = [
            self.mangled(n) + (f" = {d}" if d is not None else "")
            for n, d in zip(names, defaults, strict=True)
        ]
        return f"(({', '.join(parameters)}) => {body})"

    def on_NamedExpr(self, node: ast.NamedExpr) -> str:
        assert isinstance(node.target, ast.Name)
        return f"({self.mangled(node.target.id)} = {self.expr(node.value)})"

    def on_Yield(self, node: ast.Yield) -> str:
        return f"(yield {'null' if node.value is None else self.expr(node.value)})"

    def on_YieldFrom(self, node: ast.YieldFrom) -> str:
        return f"(yield* $iter({self.expr(node.value)}))"

    # ---- comprehensions ------------------------------------------------------------------

    def comprehension(self, generators: Sequence[ast.comprehension]) -> str:
        """Open nested loops; the caller adds the body and leaves the scope of the loop
        variables."""
        names = set()
        for generator in generators:
            names |= targets(generator.target)
        head = []
        first = self.expr(generators[0].iter)
        self._scopes.append(names)
        for n, generator in enumerate(generators):
            source = first if n == 0 else self.expr(generator.iter)
            item = self.temporary()
            head.append(f"for (const {item} of $iter({source})) {{ ")
            head.append(self.assignment(generator.target, item) + " ")
            head += [f"if (!{self.test(test)}) continue; " for test in generator.ifs]
        return f"let {', '.join(sorted(map(self.mangled, names)))}; " + "".join(head)

    def loops(self, generators: Sequence[ast.comprehension], make: object) -> str:
        head = self.comprehension(generators)
        body = make()  # type: ignore[operator]
        self._scopes.pop()
        return f"{head}{body}{'}' * len(generators)}"

    def on_ListComp(self, node: ast.ListComp) -> str:
        text = self.loops(node.generators, lambda: f"$o.push({self.expr(node.elt)});")
        return f"(() => {{ const $o = []; {text} return $o; }})()"

    def on_SetComp(self, node: ast.SetComp) -> str:
        text = self.loops(node.generators, lambda: f"$o.add({self.expr(node.elt)});")
        return f"(() => {{ const $o = set(); {text} return $o; }})()"

    def on_DictComp(self, node: ast.DictComp) -> str:
        def pair() -> str:
            return f"$set($o, {self.expr(node.key)}, {self.expr(node.value)});"

        text = self.loops(node.generators, pair)
        return f"(() => {{ const $o = $dict([]); {text} return $o; }})()"

    def on_GeneratorExp(self, node: ast.GeneratorExp) -> str:
        text = self.loops(node.generators, lambda: f"yield {self.expr(node.elt)};")
        return f"(function* () {{ {text} }})()"


# ---- modules ----------------------------------------------------------------------------------


def find(source: Path, name: str) -> Path | None:
    """Return the file of a module of the package, or None."""
    if name.split(".")[0] != source.name:
        return None
    base = source.joinpath(*name.split(".")[1:])
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def program(source: Path, roots: Sequence[str], replaced: set[str], host: str) -> str:
    """Return modules and their imports as JavaScript, without unused definitions.

    Parameters
    ----------
    source : Path
        Folder of the package.
    roots : sequence of str
        Names of modules.
    replaced : set of str
        Names of modules that the runtime replaces.
    host : str
        The JavaScript that uses the program: all names in it are kept.

    Raises
    ------
    Unknown
        A module uses a construct without a translation, or imports a module that is neither in the
        package nor replaced.
    """
    every = {
        ".".join(["fluxobs", *path.relative_to(source).with_suffix("").parts]).removesuffix(
            ".__init__"
        )
        for path in source.rglob("*.py")
    }
    modules: dict[str, Module] = {}

    def add(name: str, importer: str) -> None:
        if name in modules or name in replaced:
            return
        path = find(source, name)
        if path is None:
            raise Unknown(f"{importer} imports {name}, which has no counterpart")
        modules[name] = module = Module(name, source, path, every | replaced)
        try:
            module.text()
        except Unknown as error:
            raise Unknown(f"{error} (imported by {importer})") from None
        for imported in sorted(module.imports):
            add(imported, name)
        modules[name] = modules.pop(name)  # place the module after its imports

    for root in roots:
        add(root, "the page")
    live = alive((m.tree.body for m in modules.values()), set(re.findall(r"\w+", host)))
    by_name = called_by_name((m.tree for m in modules.values()), host)
    fresh = [Module(m.name, source, m.path, every | replaced) for m in modules.values()]
    return "".join(module.text(live, by_name) for module in fresh)
