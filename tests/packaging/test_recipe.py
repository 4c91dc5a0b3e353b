"""The recipe for conda-forge says what pyproject.toml says."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
RECIPE = yaml.safe_load((ROOT / "packaging/conda-forge/recipe.yaml").read_text("utf-8"))
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]
#: Packages that conda-forge splits: this is the one without a window system.
NAMES = {"matplotlib": "matplotlib-base"}


def as_conda(requirement):
    """``numpy>=1.26`` as ``numpy >=1.26``."""
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
    wanted = RECIPE["requirements"]
    assert wanted["run"] == ["python", *map(as_conda, PROJECT["dependencies"])]
    assert wanted["host"] == [
        "python",
        "pip",
        *map(as_conda, PYPROJECT["build-system"]["requires"]),
    ]
    (crossed,) = (one["then"] for one in wanted["build"] if isinstance(one, dict))
    assert {one for one in crossed if one.startswith("nanobind")} <= set(wanted["host"])
    cmake = PYPROJECT["tool"]["scikit-build"]["cmake"]["version"]
    assert f"cmake {cmake}" in wanted["build"]
    oldest = PROJECT["requires-python"].removeprefix(">=")
    assert RECIPE["build"]["skip"] == f'match(python, "<{oldest}")'
