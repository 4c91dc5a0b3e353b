"""List the third-party components of a wheel: bill of materials, CycloneDX 1.6, PEP 770.

    python packaging/sbom.py --nanobind 3.1.0 --robin-map INCLUDE_FOLDER --out fluxobs.cdx.json

CMake runs this script when a wheel is built. The script needs only Python. Its output does not
depend on time or place, so that builds are reproducible.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
#: Third-party components of the page and the reports. `make page` writes this file.
PAGE = ROOT / "src" / "fluxobs" / "page" / "libraries.json"


def nanobind(version: str) -> dict[str, Any]:
    """Return nanobind, the library that makes C callable from Python; each module contains it."""
    try:
        files = metadata.files("nanobind") or []
        texts = [path.read_text("utf-8") for path in files if path.name == "LICENSE"]
    except metadata.PackageNotFoundError:  # installed by the system without metadata
        texts = []
    return component("nanobind", version, "pypi", "BSD-3-Clause", texts[0] if texts else None)


def robin_map(includes: Path) -> dict[str, Any]:
    """Return nanobind's hash table; its headers contain its version and licence."""
    text = (includes / "tsl" / "robin_growth_policy.h").read_text("utf-8")
    version = ".".join(
        re.findall(r"^#define TSL_RH_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", text, re.MULTILINE)
    )
    licence = text[text.index("MIT License") : text.index("*/")]
    lines = [line.strip().removeprefix("*").strip() for line in licence.splitlines()]
    return component("robin-map", version, "github/Tessil", "MIT", "\n".join(lines).strip() + "\n")


def component(
    name: str, version: str | None, home: str, licence: str, text: str | None = None
) -> dict[str, Any]:
    """Return a library as a CycloneDX component; `home` is the type of its package URL."""
    purl = f"pkg:{home}/{name}" + (f"@{version}" if version else "")
    said: dict[str, Any] = {"expression": licence}
    if " " not in licence:
        said = {"license": {"id": licence} | ({"text": {"content": text}} if text else {})}
    return {
        "type": "library",
        "bom-ref": purl,
        "name": name,
        **({"version": version} if version else {}),
        "licenses": [said],
        "purl": purl,
    }


def bill(components: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the CycloneDX document."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    own = component(project["name"], project["version"], "pypi", project["license"])
    components = sorted(components, key=lambda one: one["bom-ref"])
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": own | {"description": project["description"]}},
        "components": components,
        "dependencies": [
            {"ref": own["bom-ref"], "dependsOn": [one["bom-ref"] for one in components]}
        ],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nanobind", required=True, help="version of nanobind")
    parser.add_argument(
        "--robin-map", required=True, type=Path, help="folder with the headers of robin-map"
    )
    parser.add_argument("--out", required=True, type=Path)
    options = parser.parse_args()
    inside = [nanobind(options.nanobind), robin_map(options.robin_map)]
    if PAGE.exists():
        inside += [component(**one) for one in json.loads(PAGE.read_text("utf-8"))]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(bill(inside), indent=1, ensure_ascii=False) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
