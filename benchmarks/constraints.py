"""The table of docs/constraints.md: the relations that every machine of the library satisfies."""

from fluxobs.research import blondel_park, discover_constraint
from fluxobs.research.energies.library import LIBRARY, doubly_fed


def row(name: str, system: object, **options: object) -> str:
    found = discover_constraint(system, **options)  # type: ignore[arg-type]
    park = blondel_park(system)  # type: ignore[arg-type]
    higher = ""
    if not found:
        others = discover_constraint(system, degree=4, **options).higher  # type: ignore[arg-type]
        degrees = sorted({(one.degree, one.degree_in_flux) for one in others})
        higher = "; ".join(f"degree {a}, {b} in λ" for a, b in degrees) or "none to degree 4"
    hidden = found.invisible.shape[1] if found else "–"
    margin = f"{found.margin:.0e}" if found else f"none: smallest {found.smallest:.0e}"
    skew = "yes" if park.transformable else f"no ({park.residual.max():.2f})"
    return f"| {name} | {len(found.relations)} | {margin} | {hidden} | {higher} | {skew} |"


if __name__ == "__main__":
    print("| machine | quadratic relations | margin | invisible | higher degree | Blondel-Park |")
    print("|---|---|---|---|---|---|")
    for make in LIBRARY:
        system = make()
        print(row(system.name, system))
    print(row("cage induction (rotor unmeasured)", doubly_fed(), ports=(0, 1)))
