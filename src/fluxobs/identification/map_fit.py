"""The flux map that a log told: values, standard deviations, and where the log has been."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import Array
from ..machines import AlgebraicSaturation
from .fit import ParameterFit
from .relations import SATURATION, Saturating

Complex = NDArray[np.complex128]

#: Share of the rows that the visited region leaves out on each side: single samples are no visit.
LEFT_OUT = 0.002
#: Points of the grid that is written, in each direction.
GRID = 21
#: Step of numerical derivatives, over the standard deviation of a parameter.
STEP = 1e-3


@dataclass(frozen=True, eq=False)
class FoundMap:
    """A flux map found in a log.

    Attributes
    ----------
    model : AlgebraicSaturation
    names : tuple of str
        Its free parameters.
    covariance, own_covariance : (names, names) ndarray
        With and without what the held parameters may turn the map by.
    visited : (points,) complex ndarray
        Corners of the region of currents d + j q that the log has visited [A].
    """

    model: AlgebraicSaturation
    names: tuple[str, ...]
    covariance: Array
    own_covariance: Array
    visited: Complex

    def flux(self, current: ArrayLike) -> Complex:
        """Flux at currents d + j q [Wb], (...)."""
        return self.model.flux(current)

    def flux_std(self, current: ArrayLike, *, own: bool = False) -> Complex:
        """Standard deviations of psi_d + j of psi_q [Wb], (...); `own`: held parameters right."""
        covariance = self.own_covariance if own else self.covariance
        psi = self.flux(current)
        columns = []
        for k, name in enumerate(self.names):
            step = STEP * float(np.sqrt(self.covariance[k, k])) + 1e-300
            moved = self.model.model_copy(update={name: getattr(self.model, name) + step})
            # what moves the current at this flux moves the flux at this current
            off = (moved.current(psi) - self.model.current(psi)) / step
            dd, dq, qq = self.model.slopes(psi)
            det = dd * qq - dq * dq
            columns.append(
                -((qq * off.real - dq * off.imag) + 1j * (dd * off.imag - dq * off.real)) / det
            )
        by = np.stack(columns, axis=-1)
        d = np.einsum("...i,ij,...j->...", by.real, covariance, by.real)
        q = np.einsum("...i,ij,...j->...", by.imag, covariance, by.imag)
        return np.asarray(np.sqrt(d) + 1j * np.sqrt(q))

    def inside(self, current: ArrayLike) -> NDArray[np.bool_]:
        """Whether the log has visited these currents, or their mirror image, (...)."""
        from scipy.spatial import Delaunay, QhullError

        i = np.asarray(current, complex)
        corners = np.stack([self.visited.real, self.visited.imag], -1)
        try:
            region = Delaunay(corners)
        except QhullError:  # all on a line
            return np.zeros(i.shape, bool)
        images = [i, i.conj()]
        if not self.model.psi_f:
            images += [-i, -i.conj()]
        points = [np.stack([image.real, image.imag], -1) for image in images]
        return np.asarray(np.any([region.find_simplex(p) >= 0 for p in points], axis=0))

    def grid(self) -> Complex:
        """Currents of a table: the visited region's box and its mirror image, (d, q)."""
        d, q = self.visited.real, np.abs(self.visited.imag).max()
        ends = (d.min(), d.max()) if self.model.psi_f else (-np.abs(d).max(), np.abs(d).max())
        return np.asarray(
            np.linspace(*ends, GRID)[:, None] + 1j * np.linspace(-q, q, GRID)[None, :]
        )

    def csv(self) -> str:
        """The table as text: current, flux, its standard deviation, and whether it was visited."""
        i = self.grid().ravel()
        psi, std, seen = self.flux(i), self.flux_std(i), self.inside(i)
        rows = ["i_d,i_q,psi_d,psi_q,psi_d_std,psi_q_std,visited"]
        for k in range(len(i)):
            numbers = (i[k].real, i[k].imag, psi[k].real, psi[k].imag, std[k].real, std[k].imag)
            rows.append(",".join(f"{x:.6g}" for x in numbers) + f",{int(seen[k])}")
        return "\n".join(rows) + "\n"

    def lines(self) -> list[str]:
        """What was found, in words."""
        out = []
        units = {
            "a_d0": "1/H",
            "a_q0": "1/H",
            "a_dd": f"A/Wb^{self.model.S + 1:g}",
            "a_qq": f"A/Wb^{self.model.T + 1:g}",
            "a_dq": f"A/Wb^{self.model.U + self.model.V + 3:g}",
            "psi_f": "Wb",
        }
        for k, name in enumerate(self.names):
            std = np.sqrt(self.covariance[k, k])
            out.append(f"{name} = {getattr(self.model, name):.4g} ± {std:.2g} {units[name]}")
        d, q = self.visited.real, self.visited.imag
        i = self.visited
        size = np.abs(self.flux(i)).max()
        most, own = (float(np.abs(self.flux_std(i, own=part)).max()) for part in (False, True))
        out.append(
            f"Visited: i_d from {d.min():.3g} to {d.max():.3g} A, i_q from {q.min():.3g} to "
            f"{q.max():.3g} A; there the map is known to ± {own:.2g} Wb or better "
            f"({own / size:.2%} of the flux) if what is held is right. Elsewhere it is the model "
            f"that speaks"
        )
        if most > HELD * own:
            out.append(
                f"With what is held as uncertain as the machine file says, ± {most:.2g} Wb: if "
                f"resistance and inverter are known better, say so by R_s_std and "
                f"inverter_voltage_std"
            )
        span_d, span_q, size_i = np.ptp(d), np.ptp(q), np.abs(i).max()
        for span, axis in ((span_d, "d"), (span_q, "q")):
            if span < FLAT * size_i:
                out.append(
                    f"i_{axis} hardly moves in this log: how psi_{axis} saturates is not told"
                )
        return out


#: Mention the held parameters if they make the map this many times less certain.
HELD = 1.5
#: A current that moves by less than this share of the largest shows no saturation along it.
FLAT = 0.3


def found_map(relation: Saturating, found: ParameterFit) -> FoundMap:
    """The map of a fit with free saturation."""
    names: Sequence[str] = [n for n in found.free if n in SATURATION or n == "psi_f"]
    places = [found.free.index(name) for name in names]
    return FoundMap(
        relation.with_values(found.values),
        tuple(names),
        found.covariance[np.ix_(places, places)],
        found.own_covariance[np.ix_(places, places)],
        _corners(found.current),
    )


def _corners(current: Complex) -> Complex:
    """Corners of the convex hull of the currents, without the outermost few."""
    from scipy.spatial import ConvexHull, QhullError

    kept = current
    for angle in np.linspace(0, np.pi, 8, endpoint=False):
        along = (current * np.exp(-1j * angle)).real
        low, high = np.quantile(along, [LEFT_OUT, 1 - LEFT_OUT])
        at = (kept * np.exp(-1j * angle)).real
        kept = kept[(at >= low) & (at <= high)]
    try:
        return np.asarray(kept[ConvexHull(np.stack([kept.real, kept.imag], -1)).vertices])
    except QhullError:
        return kept
