"""What fluxobs raises when input is unusable; the command line turns these into exit code 2."""


class FluxobsError(ValueError):
    """Base of all errors that name a thing, a place and a remedy."""


class MachineError(FluxobsError):
    """A machine's parameters are missing, unknown or impossible."""


class RecordError(FluxobsError):
    """A record, or the description of its channels, is unusable."""


class ModelError(FluxobsError):
    """A design model (energies, gains, relation, trajectory) is unusable."""
