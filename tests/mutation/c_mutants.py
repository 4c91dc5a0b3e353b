"""One-line errors in the C sources: operators, comparisons, conditions, constants."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import ziglang
from clang.cindex import Cursor, CursorKind, Diagnostic, Index, Token, TokenKind, TranslationUnit

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware"
BUILD = ROOT / "build" / "mutants"
#: Folder of the installed package, with the compiled modules and the sources that it exports.
PACKAGE = Path(sysconfig.get_path("purelib")) / "fluxobs"
#: Folder of standard headers, which libclang lacks. Without <stdbool.h>, clang drops the code that
#: uses it.
HEADERS = Path(ziglang.__file__).parent / "lib" / "include"
#: Binary operator → operators that replace it.
SWAPS = {
    "+": "-*", "-": "+*", "*": "+/", "/": "*-",
    "<": ("<=", ">"), "<=": ("<", ">"), ">": (">=", "<"), ">=": (">", "<"),
    "==": ("!=",), "!=": ("==",), "&&": ("||",), "||": ("&&",),
    "+=": ("-=",), "-=": ("+=",), "*=": ("/=",), "/=": ("*=",),
}  # fmt: skip


@dataclass(frozen=True)
class CMutant:
    """A range of bytes in a source file, and the replacement."""

    path: Path
    line: int
    name: str
    site: tuple[object, ...]
    start: int
    end: int
    text: str

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Compile the error into the installed package for as long as the context is open.

        Raises
        ------
        subprocess.CalledProcessError
            The mutant does not compile.
        """
        original = self.path.read_bytes()
        try:
            self.path.write_bytes(
                original[: self.start] + self.text.encode() + original[self.end :]
            )
            install()
            yield
        finally:
            with undisturbed():
                self.path.write_bytes(original)
                install()


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay interrupts until the context ends."""
    arrived: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: arrived.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in arrived:
            signal.raise_signal(number)


def install() -> None:
    """Compile the current sources into the installed package."""
    if not (BUILD / "build.ninja").exists():
        nanobind = subprocess.run(
            [sys.executable, "-m", "nanobind", "--cmake_dir"],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        configure = ["cmake", "-S", ROOT, "-B", BUILD, "-G", "Ninja"]
        configure += [f"-DPython_EXECUTABLE={sys.executable}"]
        configure += [f"-Dnanobind_DIR={nanobind.stdout.strip()}"]
        subprocess.run(configure, check=True, capture_output=True)
    # The build runs in a separate session, which an interrupt from the terminal cannot end.
    build = ["cmake", "--build", BUILD]
    subprocess.run(build, check=True, capture_output=True, start_new_session=True)
    for module in BUILD.glob("_core*.*"):
        if module.suffix in (".so", ".pyd"):
            # Write a new file: a running process may have mapped the old file.
            shutil.copy(module, PACKAGE / f".{module.name}")
            os.replace(PACKAGE / f".{module.name}", PACKAGE / module.name)
    for source in FIRMWARE.glob("*.[ch]"):
        shutil.copy(source, PACKAGE / "firmware" / source.name)


def c_mutants(pattern: str = "*.[ch]") -> list[CMutant]:
    """Return all errors in the functions and constants of the firmware's sources.

    Raises
    ------
    ValueError
        Clang cannot parse a source and would omit the code that it does not understand.
    """
    mutants = []
    index = Index.create()
    for path in sorted(FIRMWARE.glob(pattern)):
        unit = index.parse(
            str(path),
            args=["-std=c99", f"-I{FIRMWARE}", f"-isystem{HEADERS}", "-DFO_SINGLE=0"],
            options=TranslationUnit.PARSE_DETAILED_PROCESSING_RECORD,
        )
        errors = [str(d) for d in unit.diagnostics if d.severity >= Diagnostic.Error]
        if errors:
            raise ValueError("; ".join(errors))
        cursors = [
            cursor
            for cursor in unit.cursor.walk_preorder()
            if cursor.location.file is not None and Path(cursor.location.file.name) == path
        ]
        # An array parameter is a pointer; its size has no effect.
        sizes = [cursor.extent for cursor in cursors if cursor.kind is CursorKind.PARM_DECL]
        mutants += [
            mutant
            for cursor in cursors
            for mutant in _of_cursor(cursor)
            if mutant.path != path
            or not any(size.start.offset <= mutant.start < size.end.offset for size in sizes)
        ]
    return list({(mutant.path, mutant.start, mutant.text): mutant for mutant in mutants}.values())


def _of_cursor(cursor: Cursor) -> Iterator[CMutant]:
    tokens = list(cursor.get_tokens())
    match cursor.kind:
        case CursorKind.BINARY_OPERATOR | CursorKind.COMPOUND_ASSIGNMENT_OPERATOR:
            left_operand = next(cursor.get_children())
            end = left_operand.extent.end.offset
            after = [token for token in tokens if token.extent.start.offset >= end]
            # After "=" a sign or a star is unary.
            pairs = zip([None, *(token.spelling for token in after)], after, strict=False)
            operator = next((b for a, b in pairs if a != "=" and b.spelling in SWAPS), None)
            for text in SWAPS.get(operator.spelling, ()) if operator else ():
                yield _mutant(operator, text)
        case CursorKind.UNARY_OPERATOR if tokens and tokens[0].spelling in ("!", "-"):
            yield _mutant(tokens[0], " ")
        case CursorKind.INTEGER_LITERAL | CursorKind.FLOATING_LITERAL if tokens:
            yield from _of_number(tokens[0])
        case CursorKind.MACRO_DEFINITION:
            for token in tokens[1:]:
                yield from _of_number(token)


def _of_number(token: Token) -> Iterator[CMutant]:
    """Yield the number plus one and minus one, as the mutations of Python do."""
    number = re.fullmatch(
        r"(?P<integer>0[xX][\da-fA-F]+|\d+)[uUlL]*"
        r"|(?P<real>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[fFlL]?",
        token.spelling,
    )
    if token.kind is not TokenKind.LITERAL or number is None:
        return
    digits = number[number.lastgroup]
    value = int(digits, 0) if number.lastgroup == "integer" else float(digits)
    suffix = token.spelling.removeprefix(digits)
    for changed in (value + 1, value - 1):
        if changed != value:  # equal beyond 2^53
            yield _mutant(
                token, f"({changed!r}{suffix})" if changed < 0 else f"{changed!r}{suffix}"
            )


def _mutant(token: Token, text: str) -> CMutant:
    """Locate a macro's argument where it is written, not where the macro is used."""
    start, end = token.extent.start, token.extent.end
    path = Path(start.file.name)
    name = f"{token.spelling} -> {text.strip() or 'nothing'}"
    return CMutant(path, start.line, name, (path, start.offset), start.offset, end.offset, text)
