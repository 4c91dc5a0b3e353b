"""Errors raised for unusable input; the command line turns them into exit code 2."""


class FluxobsError(ValueError):
    """Base of all errors that a user can correct: each says what is wrong, where and the remedy."""


class MachineError(FluxobsError):
    """A machine's parameters are missing, unknown or impossible."""


class RecordError(FluxobsError):
    """A record, or the description of its channels, is unusable."""


class ObserverError(FluxobsError):
    """An observer setting cannot work."""


class UsageError(FluxobsError, TypeError):
    """Arguments do not belong together, or one is missing."""


class ModelError(FluxobsError):
    """A model (relation, immersion, energies, gains, trajectory) is unusable."""
