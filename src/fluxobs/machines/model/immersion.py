"""The exact linear system behind the observers, for any number of ports and relations.

State ``x = (s_1 … s_r, λ, κ_1 … κ_r, θ, c_1 … c_r, δ)`` with one ``(s, κ, c)`` per relation and ::

    s = λᵀQ1λ + Eᵀλ + d - λᵀQ2δ + δᵀQ3δ - Cᵀδ    κ = θᵀ(2 Q1 λ - Q2 δ + E)    c = θᵀQ1θ

θ is the drift, ``λ̇ = y_m + θ``. δ is the current bias, which is part of the state only if it is
unknown. If δ is the only unknown, ``θ = R δ`` and the state has no θ. With the volt-seconds ``v = ∫
y_m dt`` of a sample the transition is exact at any sampling rate, without discretisation.
docs/theory.md, section 4, derives it. The C core is the case of one relation, two ports and unknown
drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from .constraint import QuadraticConstraint, invisible_offsets

FloatArray = NDArray[np.floating]

Unknown = Literal["drift", "current-bias"]
UNKNOWNS: tuple[Unknown, ...] = get_args(Unknown)


@dataclass(frozen=True, eq=False)
class Immersion:
    """Linear time-varying system whose state contains flux, drift and current bias.

    Parameters
    ----------
    relations : QuadraticConstraint, or a tuple of several
        All relations must have the same number n of ports.
    unknowns : tuple of {"drift", "current-bias"}
        The unknown constants.
    R : (n, n) array_like, optional
        Resistance [Ω]; needed if the current bias is the only unknown.

    Raises
    ------
    ModelError
        Relations differ in size, `unknowns` is empty or has an invalid word, or R is missing.

    Examples
    --------
    >>> import numpy as np
    >>> pmsm = QuadraticConstraint(np.eye(2), -2e-3 * np.eye(2), 1e-6 * np.eye(2))
    >>> Immersion(pmsm).size, Immersion(pmsm, ("drift", "current-bias")).size
    (7, 9)
    """

    relations: tuple[QuadraticConstraint, ...]
    unknowns: tuple[Unknown, ...] = ("drift",)
    R: FloatArray | None = None
    #: Slices of s, flux, kappa, drift, c and current_bias in the state.
    slices: dict[str, slice] = field(init=False, repr=False)
    size: int = field(init=False, repr=False)
    _stack: dict[str, FloatArray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        relations = self.relations
        if isinstance(relations, QuadraticConstraint):
            relations = (relations,)
        relations = tuple(relations)
        if not relations or len({relation.n for relation in relations}) != 1:
            raise ModelError("relations: give at least one, all with the same number of ports")
        unknowns = set(self.unknowns)
        if not unknowns or unknowns - set(UNKNOWNS):
            raise ModelError(
                f"unknowns must be some of {', '.join(UNKNOWNS)}, got {', '.join(sorted(unknowns))}"
            )
        if unknowns == {"current-bias"} and self.R is None:
            raise ModelError("R is missing; it gives the drift if only the current bias is unknown")
        set_field = partial(object.__setattr__, self)
        set_field("relations", relations)
        set_field("unknowns", tuple(name for name in UNKNOWNS if name in unknowns))
        set_field("R", None if self.R is None else np.asarray(self.R, float))
        stack = {
            name: np.stack([getattr(relation, name) for relation in relations])
            for name in ("Q1", "Q2", "Q3", "E", "C")
        }
        set_field("_stack", stack)
        n, r = relations[0].n, len(relations)
        drift = n if "drift" in unknowns else 0
        bias = n if "current-bias" in unknowns else 0
        start, slices = 0, {}
        for name, length in zip(
            ("s", "flux", "kappa", "drift", "c", "current_bias"),
            (r, n, r, drift, r, bias),
            strict=True,
        ):
            slices[name] = slice(start, start + length)
            start += length
        set_field("slices", slices)
        set_field("size", start)

    @property
    def n(self) -> int:
        """Number of electrical ports."""
        return self.relations[0].n

    def lift(
        self, flux: ArrayLike, drift: ArrayLike | None = None, current_bias: ArrayLike | None = None
    ) -> FloatArray:
        """Return the state for flux [Wb], drift [V] and current bias [A], each (n,).

        If the current bias is the only unknown, do not give the drift: it is R times the bias.
        """
        x = np.asarray(flux)
        zero = np.zeros(self.n, dtype=x.dtype)
        delta = zero if current_bias is None else np.asarray(current_bias)
        if self.unknowns == ("current-bias",):
            if drift is not None or self.R is None:
                raise ModelError("do not give the drift: here it is R times the current bias")
            theta = self.R @ delta
        else:
            theta = zero if drift is None else np.asarray(drift)
        entries: dict[str, list[FloatArray]] = {"s": [], "kappa": [], "c": []}
        for relation in self.relations:
            Q1, Q2, Q3, E, C = (getattr(relation, name) for name in ("Q1", "Q2", "Q3", "E", "C"))
            unbiased = x @ Q1 @ x + E @ x + relation.d
            entries["s"].append(unbiased - x @ Q2 @ delta + delta @ Q3 @ delta - C @ delta)
            entries["kappa"].append(theta @ (2 * Q1 @ x - Q2 @ delta + E))
            entries["c"].append(theta @ Q1 @ theta)
        state = np.zeros(self.size, dtype=np.result_type(x, theta, delta, float))
        state[self.slices["flux"]] = x
        for name, values in entries.items():
            state[self.slices[name]] = values
        if "drift" in self.unknowns:
            state[self.slices["drift"]] = theta
        if "current-bias" in self.unknowns:
            state[self.slices["current_bias"]] = delta
        return state

    def transition(self, h: float, volt_seconds: ArrayLike) -> FloatArray:
        """Return F(h, v) of ``x₊ = F x + input``, unit upper triangular; ``F(h, v)⁻¹ = F(-h, -v)``.

        Parameters
        ----------
        h : float
            Sample time [s].
        volt_seconds : (n,) array_like
            ∫ (-R i_m + B u_m) dt over the sample [Wb].

        Returns
        -------
        (size, size) ndarray
        """
        v = np.asarray(volt_seconds)
        at, Q1, Q2 = self.slices, self._stack["Q1"], self._stack["Q2"]
        q = 2 * Q1 @ v  # (r, n): row k is (2 Q1_k v)ᵀ
        eye = np.eye(len(self.relations))
        F = np.eye(self.size, dtype=np.result_type(v, float))
        F[at["s"], at["flux"]], F[at["s"], at["kappa"]], F[at["s"], at["c"]] = (
            q,
            h * eye,
            h * h * eye,
        )
        F[at["kappa"], at["c"]] = 2 * h * eye
        if "drift" in self.unknowns:
            F[at["flux"], at["drift"]] = h * np.eye(self.n)
            F[at["s"], at["drift"]], F[at["kappa"], at["drift"]] = h * q, q
            if "current-bias" in self.unknowns:
                F[at["s"], at["current_bias"]] = -v @ Q2
        else:
            assert self.R is not None
            F[at["flux"], at["current_bias"]] = h * self.R
            F[at["s"], at["current_bias"]] = h * q @ self.R - v @ Q2
            F[at["kappa"], at["current_bias"]] = q @ self.R
        return F

    def known_input(self, volt_seconds: ArrayLike) -> FloatArray:
        """Return the input that v adds to the state: ``(vᵀQ1v + Eᵀv, v, 0, 0, 0, 0)``."""
        v = np.asarray(volt_seconds)
        increment = np.zeros(self.size, dtype=np.result_type(v, float))
        increment[self.slices["s"]] = self._stack["Q1"] @ v @ v + self._stack["E"] @ v
        increment[self.slices["flux"]] = v
        return increment

    def output_rows(self, current: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return H (r, size) and y (r,) of ``y = H x``, which are the relations at i_m."""
        i = np.asarray(current)
        rows = np.zeros((len(self.relations), self.size), dtype=np.result_type(i, float))
        rows[:, self.slices["s"]] = np.eye(len(self.relations))
        rows[:, self.slices["flux"]] = self._stack["Q2"] @ i
        Q3i = self._stack["Q3"] @ i
        if "current-bias" in self.unknowns:
            rows[:, self.slices["current_bias"]] = -2 * Q3i
        return rows, -(Q3i @ i + self._stack["C"] @ i)

    def row_gain(self) -> FloatArray:
        """Return ∂H/∂i_m, shape (r, size, n): the effect of current noise on the rows."""
        gain = np.zeros((len(self.relations), self.size, self.n))
        gain[:, self.slices["flux"]] = self._stack["Q2"]
        if "current-bias" in self.unknowns:
            gain[:, self.slices["current_bias"]] = -2 * self._stack["Q3"]
        return gain

    def transition_gain(self) -> FloatArray:
        """Return ∂F(-h, -v)/∂v as h → 0, (n, size, size): the effect of noise of v on past rows."""
        zero = np.zeros(self.n)
        return np.stack(
            [self.transition(0.0, -unit) - self.transition(0.0, zero) for unit in np.eye(self.n)]
        )

    def invisible(self) -> FloatArray:
        """Return constant offsets (r, s) of flux [Wb] and current [A] that no record can reveal.

        Returns
        -------
        (2n, k) ndarray
            See :func:`fluxobs.machines.model.constraint.invisible_offsets`.
        """
        return invisible_offsets(self.relations, self.unknowns, self.R)
