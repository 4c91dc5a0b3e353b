"""Rooms import only from lower floors of the table in CONTRIBUTING.md."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import fluxobs

ROOT = Path(fluxobs.__file__).parent
TEXT = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text("utf-8")
#: Room → floor. The compiled modules import nothing. The package itself is above all rooms and not
#: listed.
FLOOR = {
    **{
        room: int(floor)
        for floor, room in re.findall(r"^\| (\d+) \| `(\w+)[./]", TEXT, re.MULTILINE)
    },
    "_core": 0,
    "_core_single": 0,
    "_smoother": 0,
    "_engine": 0,
}
#: Floors within a room, the lowest first. Other modules are on the top floor.
WITHIN = {
    "core": (
        ("arrays", "printable", "validation"),
        ("robust", "references", "input_files", "symlinks", "locks", "forks"),
        ("engine", "hashing", "html", "output"),
    ),
    "machines": (("model",),),
    "simulation": (("closed_form", "precision"), ("runge_kutta",)),
    "research": (("energies", "regression", "relation_observer"), ("analysis",)),
    "comparison": (("baselines",),),
}
#: Modules that load JAX; `research/paper` loads it only where it computes.
JAX = ("simulation/drive", "simulation/precision", "simulation/runge_kutta")
JAX += ("research", "comparison/baselines")


def place(module: str) -> str:
    """Return the path of a module below the package, without its ending."""
    return module.removeprefix("fluxobs.").replace(".", "/")


@cache
def imports(path: Path) -> set[str]:
    """Return the modules of the package from which a file imports, at its head or in functions."""
    package = ["fluxobs", *path.relative_to(ROOT).parent.parts]
    modules = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        base = package[: len(package) - node.level + 1] if node.level else []
        module = ".".join([*base, *filter(None, [node.module])])
        if module.startswith("fluxobs"):
            modules |= {place(f"{module}.{alias.name}") for alias in node.names}
    return modules


FILES = [
    path for path in sorted(ROOT.rglob("*.py")) if path.name[:2] != "__" or path.parent != ROOT
]


def test_the_table_lists_every_room():
    rooms = {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in FILES}
    assert rooms == FLOOR.keys() - {"_core", "_core_single", "_smoother", "_engine"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_down(path):
    here = path.relative_to(ROOT).parts[0].removesuffix(".py")
    for module in imports(path):
        room = module.split("/")[0]
        if room == here or (here == "cli" and room not in FLOOR):  # fluxobs.estimate and the like
            continue
        assert FLOOR[room] < FLOOR[here], f"{here} imports {module}"


INSIDE = [path for path in FILES if path.relative_to(ROOT).parts[0] in WITHIN]


@pytest.mark.parametrize("path", INSIDE, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_within_a_room_go_down(path):
    room, here, *_ = path.relative_to(ROOT).with_suffix("").parts
    floors = {name: floor for floor, names in enumerate(WITHIN[room]) for name in names}
    for module in imports(path):
        there = module.split("/")[1] if module.startswith(f"{room}/") else here
        if there != here and here in floors:
            assert floors.get(there, len(floors)) < floors[here], f"{here} imports {module}"


def test_only_some_rooms_may_load_jax():
    for path in FILES:
        here = str(path.relative_to(ROOT).with_suffix(""))
        modules = [name for name in imports(path) if not name.startswith("research/paper")]
        if any(module.startswith(JAX) for module in modules):
            assert here.startswith((*JAX, "comparison", "campaigns", "benchmark", "planning")), path
