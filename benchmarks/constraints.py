"""Tables of docs/constraints.md: relations and visible coordinates of the library's machines."""

from fluxobs.research import blondel_park, discover_constraint
from fluxobs.research.energies.library import LIBRARY, doubly_fed
from fluxobs.research.energies.position import position_visibility


def row(name: str, system: object, **options: object) -> str:
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
    return f"| {name} | {len(result.relations)} | {margin} | {hidden} | {higher} | {skew} |"


if __name__ == "__main__":
    print("| machine | quadratic relations | margin | invisible | higher degree | Blondel-Park |")
    print("|---|---|---|---|---|---|")
    for make in LIBRARY:
        system = make()
        print(row(system.name, system))
    print(row("cage induction (rotor unmeasured)", doubly_fed(), ports=(0, 1)))

    print()
    print("| machine | ports | visible coordinates | relations | positions | seen at rest |")
    print("|---|---|---|---|---|---|")
    for make in LIBRARY:
        got = position_visibility(make())
        visible = f"{got.visible} of {got.coordinates}"
        print(
            f"| {got.name} | {got.ports} | {visible} | {got.relations} | {got.positions} "
            f"| {got.at_rest} of {got.coordinates} |"
        )
