"""What is said of a run: summary, warnings, the truth's own errors, the check of the log."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..checking.findings import Check
from ..checking.search import check_log
from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine
from ..machines.file_text import with_found
from .learning import parameters
from .result_data import facts
from .run import LogRun
from .summary import paragraph
from .truth import TruthFit, fit_truth
from .warnings import warnings


@dataclass(frozen=True, eq=False)
class ExplainedRun(LogRun):
    """A run in words; attributes as for :class:`LogRun`."""

    @cached_property
    def summary(self) -> str:
        """What the run found, in one paragraph."""
        return paragraph(self, self.checked, self.truth_fit)

    @cached_property
    def warnings(self) -> list[str]:
        """What should make a reader wary, one or two sentences each."""
        return warnings(self, self.checked, self.truth_fit)

    @property
    def facts(self) -> dict[str, Any]:
        """Summary and warnings as numbers and words that JSON can hold."""
        return facts(self, self.warnings, self.truth_fit)

    @cached_property
    def truth_fit(self) -> TruthFit | None:
        """What the truth channel is off by, fitted to the estimate; None without one."""
        samples = self.statistics.truth
        if samples is None or not isinstance(self.machine, RotatingMachine):
            return None
        return fit_truth(samples, self.machine)

    @cached_property
    def checked(self) -> Check | None:
        """What :func:`fluxobs.check` says of the log; None if it cannot be checked."""
        if not isinstance(self.machine, RotatingMachine):
            return None
        try:
            return check_log(self.log, self.machine, scales=self.scales)
        except FluxobsError:  # too many gaps
            return None

    @property
    def firmware(self) -> str | None:
        """What keeps the same observer out of firmware; None if nothing does, or it has no C."""
        plain = self.plain
        if plain is None:
            return None
        machine = self.rotor
        lacking = []
        if machine.flux_base(1.0) is None:
            lacking.append(f"psi_f ({plain.flux_base:.3g} here)")
        if not machine.rated_current:
            lacking.append(f"rated_current ({self.scales.current:.3g} here)")
        if lacking:
            return f"For an export as firmware, the machine file needs {' and '.join(lacking)}."
        if machine.inverter is not None and self.adaptive is None:
            return (
                "In firmware, the observer for the drift alone leaves the inverter to the drive: "
                "compensate it there, or export with --unknowns drift,inverter."
            )
        return None

    def export_command(self, machine: str) -> str | None:
        """The command that exports the same observer for a machine of that name."""
        plain = self.plain
        if plain is None or self.firmware is not None:
            return None
        chosen = "" if self.adaptive is None else f" --unknowns {','.join(self.unknowns)}"
        priors = dict(self.priors)
        if self.adaptive is not None and self.adaptive.inverter_std > 0:
            priors["inverter"] = self.adaptive.inverter_std  # its default depends on the log
        chosen += "".join(f" --prior {name}={std!r}" for name, std in priors.items())
        return (
            f"fluxobs export --machine {shlex.quote(machine)}{chosen} "
            f"--sample-time {plain.sample_time!r} --memory {plain.memory!r} "
            f"--current-noise {plain.current_noise!r} --drift-prior {plain.drift_prior!r} "
            f"--out FOLDER"
        )

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Name in the machine file → value and standard deviation, of what the log told."""
        if self.adaptive is None or self.learnt is None:
            return {}
        names = {"magnet flux": "psi_f", "resistance": "R_s", "inverter": "inverter_voltage"}
        return {
            names[one.name]: (one.value, one.std)
            for one in parameters(self.adaptive, self.learnt)
            if one.told
        }

    @property
    def machine_learnt(self) -> Machine:
        """The machine with what the log told, and standard deviations for the next log."""
        if self.adaptive is None or not self.found:
            return self.machine
        machine = with_found(self.rotor, self.found)
        if "inverter_voltage" not in self.found:
            return machine
        return machine.with_values(inverter_current=float(f"{self.adaptive.inverter_current:.6g}"))

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"Warning: {text}" for text in self.warnings)])
