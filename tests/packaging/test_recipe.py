"""The recipe for conda-forge agrees with pyproject.toml."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
RECIPE = yaml.safe_load((ROOT / "packaging/conda-forge/recipe.yaml").read_text("utf-8"))
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]
#: Packages that conda-forge splits → name of the part without a window system.
NAMES = {"matplotlib": "matplotlib-base"}


def as_conda(requirement):
    """Convert ``numpy>=1.26`` to ``numpy >=1.26``."""
    name, bound = re.fullmatch(r"([\w-]+)(>=[\d.]+)", requirement).groups()
    return f"{NAMES.get(name, name)} {bound}"


def test_name_version_and_links():
    assert RECIPE["package"]["name"] == PROJECT["name"]
    assert RECIPE["context"]["version"] == PROJECT["version"]
    about = RECIPE["about"]
    assert (about["homepage"], about["repository"], about["documentation"]) == tuple(
        PROJECT["urls"][name] for name in ("Homepage", "Source", "Documentation")
    )
    assert (about["summary"], about["license"]) == (PROJECT["description"], PROJECT["license"])
    assert [about["license_file"]] == PROJECT["license-files"]


def test_requirements():
    recipe = RECIPE["requirements"]
    assert recipe["run"] == ["python", *map(as_conda, PROJECT["dependencies"])]
    assert recipe["host"] == [
        "python",
        "pip",
        *map(as_conda, PYPROJECT["build-system"]["requires"]),
    ]
    (crossed,) = (entry["then"] for entry in recipe["build"] if isinstance(entry, dict))
    assert {name for name in crossed if name.startswith("nanobind")} <= set(recipe["host"])
    cmake = PYPROJECT["tool"]["scikit-build"]["cmake"]["version"]
    assert f"cmake {cmake}" in recipe["build"]
    oldest = PROJECT["requires-python"].removeprefix(">=")
    assert RECIPE["build"]["skip"] == f'match(python, "<{oldest}")'
