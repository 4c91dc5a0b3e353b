"""Tables of docs/constraints.md: relations and visible coordinates of the library's machines."""

from numbers_data import Numbers

from fluxobs.research import blondel_park, discover_constraint
from fluxobs.research.energies.library import LIBRARY, doubly_fed
from fluxobs.research.energies.position import position_visibility

RELATIONS = (
    *("machine", "quadratic relations", "margin", "invisible"),
    *("higher degree", "Blondel-Park"),
)
COORDINATES = (
    *("machine", "ports", "visible coordinates", "relations", "positions"),
    "seen at rest",
)


def row(name: str, system: object, **options: object) -> tuple[object, ...]:
    result = discover_constraint(system, **options)  # type: ignore[arg-type]
    park = blondel_park(system)  # type: ignore[arg-type]
    higher = ""
    if not result:
        higher_relations = discover_constraint(system, degree=4, **options).higher  # type: ignore[arg-type]
        degrees = sorted(
            {(relation.degree, relation.degree_in_flux) for relation in higher_relations}
        )
        higher = "; ".join(f"degree {a}, {b} in λ" for a, b in degrees) or "none to degree 4"
    hidden = result.invisible.shape[1] if result else "–"
    margin = f"{result.margin:.0e}" if result else f"none: smallest {result.smallest:.0e}"
    skew = "yes" if park.transformable else f"no ({park.residual.max():.2f})"
    return name, len(result.relations), margin, hidden, higher, skew


def coordinates(system: object) -> tuple[object, ...]:
    got = position_visibility(system)  # type: ignore[arg-type]
    visible = f"{got.visible} of {got.coordinates}"
    at_rest = f"{got.at_rest} of {got.coordinates}"
    return got.name, got.ports, visible, got.relations, got.positions, at_rest


if __name__ == "__main__":
    with Numbers("constraints") as numbers:
        systems = [make() for make in LIBRARY]
        cage = row("cage induction (rotor unmeasured)", doubly_fed(), ports=(0, 1))
        tables = {
            "relations": (RELATIONS, [*(row(system.name, system) for system in systems), cage]),
            "coordinates": (COORDINATES, [coordinates(system) for system in systems]),
        }
        for key, (header, rows) in tables.items():
            numbers.table(key, header, rows)
            print("\n".join("\t".join(map(str, cells)) for cells in (header, *rows)), end="\n\n")
