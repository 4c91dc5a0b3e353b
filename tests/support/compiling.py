"""A C compiler that compiles the same content once.

Many tests compile the same sources in other folders. An object file is kept under the hash of the
command, the source and the headers that it includes. As a program,
``python compiling.py gcc -O2 a.c b.c -o program`` is a drop-in for ``gcc …``: the tests give this
command to `make` in exported folders. Objects that no test used for a week are removed.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]([^">]+)[">]', re.MULTILINE)
OBJECTS = Path(__file__).parents[2] / "build" / "objects"
WEEK = 7 * 24 * 3600.0
SOURCES = (".c", ".cpp")
#: Options whose value is the next argument.
WITH_VALUE = ("-I", "-isystem", "-o", "-D", "-include", "-target", "-x")


@cache
def _identity(compiler: str) -> bytes:
    """Return what distinguishes two versions of a compiler."""
    path = shutil.which(compiler)
    return compiler.encode() if path is None else f"{path} {os.stat(path).st_mtime_ns}".encode()


@cache
def _objects() -> Path:
    OBJECTS.mkdir(parents=True, exist_ok=True)
    for path in OBJECTS.iterdir():
        with suppress(OSError):  # another process removed it
            if time.time() - path.stat().st_mtime > WEEK:
                path.unlink()
    return OBJECTS


def _content(source: Path, folders: Sequence[Path]) -> bytes:
    """Return the source and all headers of these folders that it includes, as one text."""
    texts: dict[str, bytes] = {}
    waiting = [source]
    while waiting:
        path = waiting.pop()
        text = path.read_bytes()
        texts[path.name] = text
        for name in INCLUDE.findall(text):
            candidates = (folder / name.decode() for folder in (path.parent, *folders))
            header = next((candidate for candidate in candidates if candidate.exists()), None)
            if header is not None and header.name not in texts:
                waiting.append(header)
    return b"\0".join(name.encode() + b"\0" + text for name, text in sorted(texts.items()))


def compiled(compiler: Sequence[str], options: Sequence[str], source: Path) -> Path:
    """Return the object file of a source; compile if the content is new.

    Raises
    ------
    subprocess.CalledProcessError
        The source does not compile; the compiler's messages are on stderr.
    """
    flags: list[str] = []
    folders: list[Path] = []
    for option in options:
        if option.startswith("-I") and len(option) > 2:
            folders.append(Path(option[2:]))
        else:
            flags.append(option)
    digest = hashlib.sha256(_identity(compiler[0]))
    for part in ("\0".join([*compiler, *flags]).encode(), _content(source, folders)):
        digest.update(hashlib.sha256(part).digest())
    target = _objects() / f"{source.stem}-{digest.hexdigest()[:32]}.o"
    if target.exists():
        os.utime(target)
        return target
    partial = target.with_suffix(f".{os.getpid()}.part")
    try:
        command = [*compiler, *options, "-c", str(source), "-o", str(partial)]
        subprocess.run(command, check=True)
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def run_compiler(compiler: Sequence[str], arguments: Sequence[str | Path]) -> None:
    """Compile and link as the compiler would with these arguments.

    Raises
    ------
    subprocess.CalledProcessError
        A source does not compile, or the program does not link.
    """
    options, sources, link, output = [], [], [], None
    words = iter(map(str, arguments))
    for word in words:
        value = next(words) if word in WITH_VALUE else None
        if word == "-o":
            output = value
        elif Path(word).suffix in SOURCES and not word.startswith("-"):
            sources.append(Path(word))
        elif word.startswith("-l") or Path(word).suffix in (".o", ".a", ".so"):
            link.append(word)
        else:
            options += (
                [word + value] if word == "-I" else [word] if value is None else [word, value]
            )
    if "-c" in options:
        options.remove("-c")
        for source in sources:
            shutil.copyfile(compiled(compiler, options, source), output or f"{source.stem}.o")
        return
    if not sources or output is None:
        subprocess.run([*compiler, *map(str, arguments)], check=True)
        return
    objects = [str(compiled(compiler, options, source)) for source in sources]
    linked = [option for option in options if not option.startswith(("-I", "-D", "-W"))]
    linked = [option for option in linked if not option.startswith("-std=")]
    subprocess.run([*compiler, *linked, *objects, *link, "-o", output], check=True)


def build_program(
    compiler: Sequence[str],
    options: Sequence[str | Path],
    sources: Sequence[str | Path],
    program: Path,
    libraries: Sequence[str] = ("-lm",),
) -> Path:
    """Compile sources and link them into a program; return its path."""
    run_compiler(compiler, [*options, *sources, *libraries, "-o", program])
    return program


def command(compiler: Sequence[str] = ("gcc",)) -> str:
    """Return the command of this compiler for a makefile's CC."""
    return " ".join([sys.executable, str(Path(__file__)), *compiler, "--"])


def main() -> int:
    arguments = sys.argv[1:]
    end = arguments.index("--")
    try:
        run_compiler(arguments[:end], arguments[end + 1 :])
    except subprocess.CalledProcessError as error:
        return error.returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
