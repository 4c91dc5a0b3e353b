"""No room imports one above it: the layers that CONTRIBUTING.md draws."""

import ast
from pathlib import Path

import pytest

import fluxobs

ROOT = Path(fluxobs.__file__).parent
#: From the ground up. A room may import those before it; rooms of one line do not know each other.
LAYERS = (
    ("errors", "validation", "texts"),
    ("named", "files", "links", "locks"),
    ("output", "hashing", "plots", "html", "web", "engine"),
    ("_core", "_core_single"),
    ("model",),
    ("machines",),
    ("logs",),
    ("observers",),
    ("checking",),
    ("synthetic", "estimation", "design"),
    ("identification", "deployment", "comparison", "live", "hosts"),
    ("examination", "campaigns", "fleets"),
    ("paper",),
    ("cli",),
)
#: Beside the layers: `output` serves `plots`, and the package itself is the door over all of it.
ALLOWED = {("plots", "output"), ("validation", "errors"), ("__main__", "cli")}
FLOOR = {room: floor for floor, rooms in enumerate(LAYERS) for room in rooms}


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else "__init__"


def imports(path: Path) -> set[str]:
    """Rooms that a file imports from, at its head or inside."""
    package = ["fluxobs", *path.relative_to(ROOT).parent.parts]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            found |= {room_of(".".join([*base, name])) for name in names if name}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fluxobs."):
            found.add(room_of(node.module))
    return found


FILES = [path for path in sorted(ROOT.rglob("*.py")) if path.parent != ROOT or path.stem in FLOOR]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_down(path):
    here = path.relative_to(ROOT).parts[0].removesuffix(".py")
    for room in imports(path) - {here}:
        if here == "cli" and room not in FLOOR:  # the door: fluxobs.estimate and its like
            continue
        assert (here, room) in ALLOWED or FLOOR[room] < FLOOR[here], f"{here} imports {room}"


def test_jax_is_behind_a_wall():
    """Only these rooms may load the design layer."""
    for path in FILES:
        here = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if "design" in imports(path):
            assert here in ("design", "comparison", "campaigns", "paper"), path
