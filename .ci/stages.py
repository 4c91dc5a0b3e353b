"""Run the stages of `.ci/run`, two single-core stages at a time; print the time of each.

python3 .ci/stages.py [--all] [--list] [--only NAME …]

A stage with `files` is repeated only if one of these files changed since the stage last passed on
this computer. The hash of their contents, with the versions of the tools, is kept in the user's
cache folder and printed in the log. `--all` runs everything, as the nightly run does; `--list`
prints what would run. `--only` runs some stages, for example `--only lint MISRA`.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fluxobs-ci"
#: What every test run may depend on.
COMMON = ("pyproject.toml", "Makefile", "CMakeLists.txt", ".ci", "tests/conftest.py")
FIRMWARE = ("firmware", "tests/firmware", "tests/support")
#: The library that estimates; `research` is apart.
LIBRARY = (
    *("src", "binding", "smoothing", "engine", "firmware"),
    *("tests", "examples", "web", "packaging"),
)
#: The paper's mathematics, and what it uses; nothing else uses the folders in APART.
APART = ("src/fluxobs/research/paper", "tests/research")
PAPER = (
    *(f"src/fluxobs/{room}" for room in ("research", "machines", "core", "simulation")),
    *("src/fluxobs/observers", "src/fluxobs/cli", "binding", "firmware"),
    *("tests/research", "tests/support", "tests/expected/reproduce.json"),
)
PYTEST = ".venv/bin/python -m pytest -n auto --dist loadfile --no-loadscope-reorder"


@dataclass(frozen=True)
class Stage:
    """A command; `files` are the paths on which its result depends (empty: all)."""

    name: str
    command: str
    files: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    tools: tuple[str, ...] = ()
    #: Two stages that use one core run at the same time.
    single: bool = False


STAGES = (
    Stage("bare machine", ".ci/bare"),
    Stage("tools", ".ci/tools"),
    Stage("page", "make page"),
    Stage("lint", "make lint", single=True),
    Stage("warnings", "make warnings", (*FIRMWARE, "engine"), tools=("gcc", "clang"), single=True),
    Stage("MISRA", "make misra", FIRMWARE, tools=("cppcheck",), single=True),
    Stage("sanitizers", "make sanitize", FIRMWARE, tools=("gcc",), single=True),
    Stage(
        "processors",
        "make pil",
        (*FIRMWARE, "src/fluxobs/deployment", "src/fluxobs/machines", "src/fluxobs/observers"),
        tools=("arm-none-eabi-gcc", "qemu-system-arm"),
        single=True,
    ),
    Stage(
        "hosts",
        "make hosts",
        ("src/fluxobs", "binding", "firmware", "tests/hosts", "examples"),
        without=APART,
        single=True,
    ),
    Stage(
        "fuzz",
        "make fuzz",
        (*FIRMWARE, "src/fluxobs/logs", "src/fluxobs/core", "tests/logs"),
        tools=("clang",),
        single=True,
    ),
    Stage(
        "skipped on a bare machine",
        f"xargs --no-run-if-empty --delimiter='\\n' {PYTEST} <build/skipped",
    ),
    Stage("slow tests of the paper", f"{PYTEST} -m slow tests/research", PAPER),
    Stage("slow tests", f"{PYTEST} -m slow --ignore tests/research", LIBRARY, without=APART),
)


def content(stage: Stage) -> str:
    """Return the hash of the files and tools of a stage."""
    digest = hashlib.sha256(f"{stage.command} {sys.version}".encode())
    for tool in filter(shutil.which, stage.tools):
        done = subprocess.run([tool, "--version"], capture_output=True, check=False)
        digest.update(done.stdout)
    paths = [*stage.files, *COMMON]
    listed = subprocess.run(
        ["git", "ls-files", "-s", "-z", "--", *paths], cwd=ROOT, capture_output=True, check=True
    )
    changed = subprocess.run(
        ["git", "diff", "HEAD", "--", *paths], cwd=ROOT, capture_output=True, check=True
    )
    digest.update(changed.stdout)  # of a checkout with uncommitted changes
    for line in listed.stdout.decode().split("\0"):
        if line and not line.partition("\t")[2].startswith(tuple(f"{p}/" for p in stage.without)):
            digest.update(line.encode())
    return digest.hexdigest()[:16]


def unchanged(stage: Stage, everything: bool) -> str | None:
    """Return when the stage passed with the same content, or None if it must run."""
    if everything or not stage.files:
        return None
    record = CACHE / f"{stage.name.replace(' ', '-')}-{content(stage)}"
    return record.read_text().strip() if record.exists() else None


def run(stage: Stage, everything: bool) -> tuple[Stage, float, str]:
    """Run a stage; return its time [s] and "passed", "failed" or "unchanged since …"."""
    if (passed := unchanged(stage, everything)) is not None:
        return stage, 0.0, f"unchanged since {passed}"
    began = time.monotonic()
    log = ROOT / "build" / f"stage-{stage.name.replace(' ', '-')}.log"
    log.parent.mkdir(exist_ok=True)
    if stage.single:  # the outputs of two stages at a time would mix
        with log.open("wb") as file:
            done = subprocess.run(
                ["bash", "-c", stage.command], cwd=ROOT, stdout=file, stderr=subprocess.STDOUT
            )
        print(f"\n==== {stage.name}\n{log.read_text('utf-8', 'replace')}", flush=True)
    else:
        print(f"\n==== {stage.name}", flush=True)
        done = subprocess.run(["bash", "-c", stage.command], cwd=ROOT)
    if done.returncode == 0 and stage.files:
        CACHE.mkdir(parents=True, exist_ok=True)
        revision = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True
        )
        name = f"{stage.name.replace(' ', '-')}-{content(stage)}"
        (CACHE / name).write_text(f"{revision.stdout.strip()}, {time.strftime('%Y-%m-%d %H:%M')}\n")
    verdict = "passed" if done.returncode == 0 else "FAILED"
    return stage, time.monotonic() - began, verdict


def groups(stages: Iterable[Stage]) -> list[list[Stage]]:
    """Return the stages in order; neighbours that use one core are in one group."""
    grouped: list[list[Stage]] = []
    for stage in stages:
        if grouped and stage.single and grouped[-1][-1].single:
            grouped[-1].append(stage)
        else:
            grouped.append([stage])
    return grouped


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--all", action="store_true", help="run unchanged stages, too")
    parser.add_argument("--list", action="store_true", help="print what would run, and end")
    names = [stage.name for stage in STAGES]
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    options = parser.parse_args()
    chosen = [stage for stage in STAGES if stage.name in options.only]
    if options.list:
        for stage in chosen:
            passed = unchanged(stage, options.all)
            print(f"{stage.name:26} {'runs' if passed is None else f'unchanged since {passed}'}")
        return 0
    results, began = [], time.monotonic()
    for group in groups(chosen):
        with ThreadPoolExecutor(max_workers=2) as pool:
            results += pool.map(lambda stage: run(stage, options.all), group)
        if any(verdict == "FAILED" for _, _, verdict in results):
            break
    print("\n==== times")
    for stage, seconds, verdict in results:
        shown = f"content {content(stage)}" if stage.files else ""
        print(f"{seconds:7.0f} s  {stage.name:26} {verdict:10} {shown}")
    print(
        f"{time.monotonic() - began:7.0f} s  in all, two single-core stages at a time", flush=True
    )
    return int(any(verdict == "FAILED" for _, _, verdict in results))


if __name__ == "__main__":
    sys.exit(main())
