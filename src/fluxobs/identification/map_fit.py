"""Flux map identified from a log, with standard deviations and the visited region."""

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

#: Share of rows excluded on each side of the visited region, so that no single sample counts as a
#: visit.
LEFT_OUT = 0.002
#: Points of the written grid in each direction.
GRID = 21
#: Step of numerical derivatives, in standard deviations of a parameter.
STEP = 1e-3


@dataclass(frozen=True, eq=False)
class FoundMap:
    """Flux map identified from a log.

    Attributes
    ----------
    model : AlgebraicSaturation
    names : tuple of str
        Free parameters of the model.
    covariance, own_covariance : (names, names) ndarray
        Covariance with, and without, the uncertainty of the held parameters.
    visited : (points,) complex ndarray
        Corners of the region of currents d + j q that the log has visited [A].
    """

    model: AlgebraicSaturation
    names: tuple[str, ...]
    covariance: Array
    own_covariance: Array
    visited: Complex

    def flux(self, current: ArrayLike) -> Complex:
        """Return the flux at currents d + j q [Wb], (...)."""
        return self.model.flux(current)

    def flux_std(self, current: ArrayLike, *, own: bool = False) -> Complex:
        """Return (standard deviation of psi_d) + j (standard deviation of psi_q) [Wb], (...).

        With `own`, the held parameters are assumed to be exact.
        """
        covariance = self.own_covariance if own else self.covariance
        psi = self.flux(current)
        columns = []
        for k, name in enumerate(self.names):
            step = STEP * float(np.sqrt(self.covariance[k, k])) + 1e-300
            moved = self.model.model_copy(update={name: getattr(self.model, name) + step})
            # Convert the change of current at this flux to the change of flux at this current.
            current_change = (moved.current(psi) - self.model.current(psi)) / step
            dd, dq, qq = self.model.slopes(psi)
            determinant = dd * qq - dq * dq
            columns.append(
                -(
                    (qq * current_change.real - dq * current_change.imag)
                    + 1j * (dd * current_change.imag - dq * current_change.real)
                )
                / determinant
            )
        flux_change = np.stack(columns, axis=-1)
        d = np.einsum("...i,ij,...j->...", flux_change.real, covariance, flux_change.real)
        q = np.einsum("...i,ij,...j->...", flux_change.imag, covariance, flux_change.imag)
        return np.asarray(np.sqrt(d) + 1j * np.sqrt(q))

    def inside(self, current: ArrayLike) -> NDArray[np.bool_]:
        """Return whether the log has visited each current or its mirror images, (...)."""
        from scipy.spatial import Delaunay, QhullError

        currents = np.asarray(current, complex)
        corners = np.stack([self.visited.real, self.visited.imag], -1)
        try:
            region = Delaunay(corners)
        except QhullError:  # all corners lie on a line
            return np.zeros(currents.shape, bool)
        images = [currents, currents.conj()]
        if not self.model.psi_f:
            images += [-currents, -currents.conj()]
        points = [np.stack([image.real, image.imag], -1) for image in images]
        return np.asarray(np.any([region.find_simplex(p) >= 0 for p in points], axis=0))

    def grid(self) -> Complex:
        """Return the grid of a table, (d, q); it covers the visited region and its mirror image."""
        d, q = self.visited.real, np.abs(self.visited.imag).max()
        ends = (d.min(), d.max()) if self.model.psi_f else (-np.abs(d).max(), np.abs(d).max())
        return np.asarray(
            np.linspace(*ends, GRID)[:, None] + 1j * np.linspace(-q, q, GRID)[None, :]
        )

    def csv(self) -> str:
        """Return the table as CSV: current, flux, the flux's standard deviation, and visited."""
        i = self.grid().ravel()
        psi, std, visited = self.flux(i), self.flux_std(i), self.inside(i)
        rows = ["i_d,i_q,psi_d,psi_q,psi_d_std,psi_q_std,visited"]
        for k in range(len(i)):
            numbers = (i[k].real, i[k].imag, psi[k].real, psi[k].imag, std[k].real, std[k].imag)
            rows.append(",".join(f"{x:.6g}" for x in numbers) + f",{int(visited[k])}")
        return "\n".join(rows) + "\n"

    def lines(self) -> list[str]:
        """Return the parameters and the accuracy of the map as text, one statement per line."""
        sentences = []
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
            sentences.append(f"{name} = {getattr(self.model, name):.4g} ± {std:.2g} {units[name]}")
        d, q = self.visited.real, self.visited.imag
        i = self.visited
        size = np.abs(self.flux(i)).max()
        total_std, own_std = (
            float(np.abs(self.flux_std(i, own=exact)).max()) for exact in (False, True)
        )
        sentences.append(
            f"Visited: i_d from {d.min():.3g} to {d.max():.3g} A, i_q from {q.min():.3g} to "
            f"{q.max():.3g} A; there the flux is known to ± {own_std:.2g} Wb or better "
            f"({own_std / size:.2%} of the flux) if the held parameters are right. Elsewhere the "
            f"model extrapolates"
        )
        if total_std > HELD * own_std:
            sentences.append(
                f"With the uncertainty of the held parameters, the flux is known to ± "
                f"{total_std:.2g} Wb. If resistance and inverter are known better, set R_s_std "
                f"and inverter_voltage_std"
            )
        span_d, span_q, size_i = np.ptp(d), np.ptp(q), np.abs(i).max()
        for span, axis in ((span_d, "d"), (span_q, "q")):
            if span < FLAT * size_i:
                sentences.append(
                    f"i_{axis} hardly changes in this log: the saturation of psi_{axis} cannot "
                    f"be identified"
                )
        return sentences


#: Mention the held parameters if they increase the standard deviation by more than this factor.
HELD = 1.5
#: A current that varies by less than this share of the largest current identifies no saturation.
FLAT = 0.3


def map_of_fit(relation: Saturating, fit: ParameterFit) -> FoundMap:
    """Return the map of a fit with free saturation."""
    names: Sequence[str] = [n for n in fit.free if n in SATURATION or n == "psi_f"]
    places = [fit.free.index(name) for name in names]
    return FoundMap(
        relation.with_values(fit.values),
        tuple(names),
        fit.covariance[np.ix_(places, places)],
        fit.own_covariance[np.ix_(places, places)],
        _corners(fit.current),
    )


def _corners(current: Complex) -> Complex:
    """Return the corners of the convex hull of the currents, without the outermost few."""
    from scipy.spatial import ConvexHull, QhullError

    inner = current
    for angle in np.linspace(0, np.pi, 8, endpoint=False):
        along = (current * np.exp(-1j * angle)).real
        low, high = np.quantile(along, [LEFT_OUT, 1 - LEFT_OUT])
        inner_along = (inner * np.exp(-1j * angle)).real
        inner = inner[(inner_along >= low) & (inner_along <= high)]
    try:
        return np.asarray(inner[ConvexHull(np.stack([inner.real, inner.imag], -1)).vertices])
    except QhullError:
        return inner
