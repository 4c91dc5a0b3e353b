"""Builds the page: the package's modules translated, the observers as WebAssembly, one HTML file.

Needs clang with lld and wasi-libc, and Node.js with npm; `make page` calls it.
"""

from __future__ import annotations

import gzip
import json
import lzma
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np

from fluxobs.web.columns import as_text
from libraries import libraries, notices
from translate import program

WEB = Path(__file__).parent
ROOT = WEB.parent
PACKAGE = ROOT / "src" / "fluxobs"
BUILD = ROOT / "build" / "page"
CLANG = "clang --target=wasm32-wasi -ffp-contract=off -nostartfiles -Wl,--no-entry -Wl,--strip-all"
#: Parts of the runtime, in order.
RUNTIME = ("language", "arrays", "library", "core", "text", "npz")
#: Modules that the page asks for; it gets what these import.
ROOTS = (
    "fluxobs.estimation.passes",
    "fluxobs.estimation.explained",
    "fluxobs.estimation.again",
    "fluxobs.estimation.shown",
    "fluxobs.live",
    "fluxobs.logs.for_machine",
    "fluxobs.logs.channels",
    "fluxobs.logs.formats.nested",
    "fluxobs.logs.formats.text",
    "fluxobs.machines",
    "fluxobs.machines.new",
)
#: Modules of others, and of the package, that the runtime has.
REPLACED = {
    *["numpy", "numpy.typing", "scipy.interpolate", "pydantic"],
    *[
        "abc",
        "binascii",
        "bisect",
        "collections",
        "collections.abc",
        "csv",
        "dataclasses",
        "difflib",
        "functools",
        "importlib",
    ],
    *[
        "importlib.resources",
        "io",
        "itertools",
        "math",
        "numbers",
        "os",
        "pathlib",
        "re",
        "shlex",
        "tempfile",
        "tomllib",
    ],
    *["typing", "weakref"],
    *["fluxobs._core", "fluxobs._core_single", "fluxobs.files", "fluxobs.html", "fluxobs.named"],
    "fluxobs.output",
    *[
        "fluxobs.logs.formats.text.packed",
        "fluxobs.logs.formats.text.parse",
        "fluxobs.logs.formats.npy",
        "fluxobs.logs.formats.npz",
    ],
}
#: Files of the package that its modules read.
RESOURCES = ("machines/examples", "logs/presets")
#: Rows of the demo log that the page carries.
DEMO_ROWS = 1_300


def install() -> None:
    """The libraries of others, in the versions of package-lock.json."""
    done, wanted = WEB / "node_modules" / ".package-lock.json", WEB / "package-lock.json"
    if not done.exists() or done.stat().st_mtime < wanted.stat().st_mtime:
        subprocess.run(["npm", "ci", "--no-audit", "--no-fund", "--silent"], cwd=WEB, check=True)


def wasm() -> bytes:
    """The observers and the parser of text as a WebAssembly module."""
    made = BUILD / "core.wasm"
    text = BUILD / "cells.o"  # text alone takes sixteen bytes at once
    command = [*CLANG.split(), "-O3", "-msimd128", "-c", str(WEB / "cells.c"), "-o", str(text)]
    subprocess.run([one for one in command if not one.startswith(("-Wl", "-nostart"))], check=True)
    sources = [WEB / "core.c", *sorted((ROOT / "firmware").glob("*.c")), text]
    includes = [f"-I{ROOT / 'firmware'}", f"-I{ROOT / 'binding'}"]
    command = [*CLANG.split(), "-Oz", *includes, *map(str, sources), "-o", str(made)]
    subprocess.run(command, check=True)
    return made.read_bytes()


def library() -> str:
    """The runtime and the package as one JavaScript module."""
    parts = [
        'import { parse as $toml } from "smol-toml";\n',
        'import { unzipSync as $unzip } from "fflate";\n',
    ]
    parts += [(WEB / "runtime" / f"{name}.js").read_text("utf-8") for name in RUNTIME]
    host = "".join(parts) + (WEB / "app" / "worker.js").read_text("utf-8")
    parts.append(program(PACKAGE, ROOTS, REPLACED, host))
    for folder in RESOURCES:
        for path in sorted((PACKAGE / folder).iterdir()):
            if path.suffix in (".toml", ".csv"):
                text = json.dumps(path.read_text("utf-8") if path.suffix == ".csv" else bare(path))
                parts.append(
                    f'$files.set("fluxobs/{folder}/{path.name}", $encoded({text}, "utf-8"));\n'
                )
    return "".join(parts)


def bare(path: Path) -> str:
    """A TOML file without the lines that are comments."""
    lines = path.read_text("utf-8").splitlines(keepends=True)
    return "".join([line for line in lines if not line.startswith("#")])


def bundled(entry: Path, style: str) -> str:
    """A module and what it imports, as one small script."""
    command = [
        "npx",
        "--no-install",
        "esbuild",
        str(entry),
        "--bundle",
        "--minify",
        f"--format={style}",
    ]
    command += ["--charset=utf8", "--legal-comments=none", "--target=es2022", "--log-level=warning"]
    done = subprocess.run(command, cwd=WEB, check=True, capture_output=True)
    return done.stdout.decode("utf-8")


def demo() -> bytes:
    """The first rows of the demo log as app/demo.js reads them: a header, then second differences,
    which are small, of whole numbers."""
    names, *lines = (PACKAGE / "synthetic" / "demo_log.csv").read_text("utf-8").splitlines()
    cells = [line.split(",") for line in lines[:DEMO_ROWS]]
    digits = [len(cell.partition(".")[2]) for cell in cells[0]]
    header = {"digits": dict(zip(names.split(","), digits, strict=True)), "rows": len(cells)}
    text = json.dumps(header).encode("utf-8")
    out = len(text).to_bytes(2, "little") + text
    for column, places in zip(zip(*cells, strict=True), digits, strict=True):
        whole = np.round(np.array(column, float) * 10**places).astype(np.int64)
        twice = np.diff(np.concatenate([[0, 0], whole]), n=2).astype("<i4")
        out += twice.view(np.uint8).reshape(-1, 4)[:, :3].T.tobytes()
    return out


def archived(data: bytes) -> str:
    """As small as it gets, as text that a script element keeps."""
    wanted = {"id": lzma.FILTER_LZMA1, "preset": 9 | lzma.PRESET_EXTREME, "pb": 0}
    return as_text(lzma.compress(data, lzma.FORMAT_ALONE, filters=[wanted]))


def main() -> None:
    BUILD.mkdir(parents=True, exist_ok=True)
    install()
    (BUILD / "library.mjs").write_text(
        library() + "export { $import, $files, $load, $kw, $dict, $as, str, repr, format };\n",
        "utf-8",
    )
    worker = WEB / "app" / ".worker.mjs"
    try:
        worker.write_text(library() + (WEB / "app" / "worker.js").read_text("utf-8"), "utf-8")
        code = bundled(worker, "iife")
    finally:
        worker.unlink(missing_ok=True)
    style = (WEB / "node_modules" / "uplot" / "dist" / "uPlot.min.css").read_text("utf-8")
    style += bundled(WEB / "app" / "style.css", "iife")
    listed = libraries()
    shared = {"worker": code.encode("utf-8"), "style": style.encode("utf-8")}
    shared["notices"] = notices(listed).encode("utf-8")
    write("page", shared | {"wasm": wasm(), "demo": demo()})
    write("report", shared | {"wasm": wasm()})
    text = json.dumps(listed, indent=1, ensure_ascii=False) + "\n"
    (PACKAGE / "web" / "libraries.json").write_text(text, "utf-8")


def write(name: str, parts: dict[str, bytes]) -> None:
    """Fill a template; what stands for a report's data is left."""
    app = bundled(WEB / "app" / f"{name}.js", "esm").encode("utf-8")
    parts = {"app": app, **parts}
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    decoder = bundled(WEB / "app" / "lzma.js", "esm").encode("utf-8")
    values = {
        "version": version,
        "parts": json.dumps({part: len(data) for part, data in parts.items()}),
        "lzma": as_text(gzip.compress(decoder, 9, mtime=0)),
        "archive": archived(b"".join(parts.values())),
        "boot": bundled(WEB / "app" / "boot.js", "esm"),
    }
    lines = (WEB / "app" / f"{name}.html").read_text("utf-8").split("\n")
    page = "\n".join([line.strip() for line in lines])
    for key, value in values.items():
        page = page.replace("{{" + key + "}}", value)
    out = PACKAGE / "web" / f"{name}.html"
    out.write_text(page, "utf-8")
    print(f"Written: {out.relative_to(ROOT)}, {len(page.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
