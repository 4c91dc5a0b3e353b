"""What fluxobs raises when input is unusable; the command line turns these into exit code 2."""


class FluxobsError(ValueError):
    """Base of all errors of a user's making: each names a thing, a place and a remedy."""


class MachineError(FluxobsError):
    """A machine's parameters are missing, unknown or impossible."""


class RecordError(FluxobsError):
    """A record, or the description of its channels, is unusable."""


class ObserverError(FluxobsError):
    """A setting of an observer cannot work."""


class UsageError(FluxobsError, TypeError):
    """Arguments that do not belong together, or one that is missing."""


class ModelError(FluxobsError):
    """A model (relation, immersion, energies, gains, trajectory) is unusable."""
