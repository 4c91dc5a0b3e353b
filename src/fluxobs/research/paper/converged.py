"""Runs of the paper's two very stiff laws, with steps small enough for convergence.

With the printed gains, the rates reach 10⁵ 1/s and more, but the errors of interest last for
seconds. The module therefore integrates the error instead of the estimate. The error obeys a linear
equation, whose steps need not resolve the rates (:mod:`fluxobs.research.analysis.flow`). Between
rows, the regressor is a cubic spline.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.arrays import Array
from ..analysis.flow import flow_states
from ..analysis.stability import balanced_error_system, record_nodes
from ..regression import Parametrisation, Regressors
from ..regression.laws.base import positive_definite
from .levitation import FilteredRecord, LevitationRecord

#: Change of an error, as a share of the largest error, below which the doubling of substeps ends;
#: largest number of substeps.
CONVERGED, MAX_SUBSTEPS = 1e-3, 16


class ConvergedRun(NamedTuple):
    """Errors at every row.

    Attributes
    ----------
    error : (rows, N) ndarray
        Errors of flux [Wb] and, for the adaptive law, of the constants.
    change : float
        Largest change at the last doubling of the substeps, over the largest error.
    """

    error: Array
    change: float


class _Span(NamedTuple):
    """Rows between jumps: ψ and residual in balanced coordinates, constant input, error jump."""

    psi: Array
    r: Array
    f: Array
    jump: Array  # change of the error at the start


def converged_run(
    record: LevitationRecord,
    regression: FilteredRecord,
    Gamma: Any,
    constants: Parametrisation | None,
    skip: int,
) -> ConvergedRun:
    """Return the error of Proposition 2 (or 1 if `constants` is None), starting at zero estimates.

    The regression is used from row `skip` on, as in :func:`fluxobs.research.regression.laws.run`.
    Until then, the estimate integrates the volt-seconds.
    """
    n = record.flux.shape[1]
    if constants is None:
        root = np.linalg.cholesky(np.asarray(positive_definite("Gamma", Gamma, n)))
        N = np.zeros((n, n))
    else:
        N, root = balanced_error_system(constants, Gamma)
    spans = _spans(record, regression, constants, root, skip)
    error = np.empty((len(record.t), len(root)))
    theta = np.zeros(len(root) - n) if constants is None else _constants(record, constants, 0)
    integrated = np.cumsum(record.volt_seconds[: skip + 1], axis=0)
    error[: skip + 1] = np.column_stack(
        [integrated - record.flux[: skip + 1], np.tile(-theta, (skip + 1, 1))]
    )
    start = np.linalg.solve(root, error[skip])
    coarse = _run(N, spans, start, record.h, 1)
    change, substeps = np.inf, 1
    while change > CONVERGED and substeps < MAX_SUBSTEPS:
        substeps *= 2
        fine = _run(N, spans, start, record.h, substeps)
        moved, size = np.abs((fine - coarse) @ root.T), np.abs(fine @ root.T)
        finite = np.isfinite(size).all(axis=1)
        change = float((moved[finite] / size[finite].max(axis=0)).max())
        coarse = fine
    error[skip + 1 :] = coarse @ root.T
    return ConvergedRun(error, change)


def _constants(record: LevitationRecord, constants: Parametrisation, row: int) -> Array:
    return np.asarray(constants.constants(record.drift[row], record.current_bias[row]))


def _spans(
    record: LevitationRecord,
    regression: FilteredRecord,
    constants: Parametrisation | None,
    root: Array,
    skip: int,
) -> list[_Span]:
    jump = int(np.searchsorted(record.t, record.jump - record.h / 2))
    joined = Regressors(
        *(
            np.concatenate(
                [np.asarray(entries)[: jump + 1], [after], np.asarray(entries)[jump + 1 :]]
            )
            for entries, after in zip(regression.rows, regression.after_jump, strict=True)
        )  # type: ignore[arg-type]
    )
    whole = np.asarray(joined.Phi_flux if constants is None else constants.psi_record(joined))
    spans: list[_Span] = []
    previous = np.zeros(len(root))
    for row, rows, flux in (
        (0, slice(skip, jump + 1), record.flux[skip : jump + 1]),
        (-1, slice(jump + 1, None), record.flux[jump:]),
    ):
        psi = whole[rows]
        theta = np.zeros(0) if constants is None else _constants(record, constants, row)
        true = np.column_stack([flux, np.tile(theta, (len(flux), 1))])
        r = np.asarray(joined.y)[rows] - np.einsum("ki,ki->k", psi, true)
        f = np.zeros(len(root)) if constants is not None else -record.drift[row]
        truth = np.concatenate([np.zeros(flux.shape[1]), theta])
        moved = np.zeros(len(root)) if not spans else np.linalg.solve(root, previous - truth)
        spans.append(_Span(psi @ root, r, np.linalg.solve(root, f), moved))
        previous = truth
    return spans


def _run(N: Array, spans: list[_Span], x: Array, h: float, substeps: int) -> Array:
    pieces = []
    for span in spans:
        nodes = record_nodes(np.column_stack([span.psi, span.r]), substeps)
        psi, r, start = nodes[..., :-1], nodes[..., -1], x + span.jump
        states = flow_states(N, psi, h / substeps, start, r, span.f)[substeps - 1 :: substeps]
        pieces.append(states)
        x = states[-1]
    return np.concatenate(pieces)
