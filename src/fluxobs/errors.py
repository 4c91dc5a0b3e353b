"""Errors for unusable input; the command line turns them into exit code 2."""


class FluxobsError(ValueError):
    """Base of all errors that a user can correct; messages say what is wrong and what to do."""

    def __str__(self) -> str:
        """Return the message, with quoted file contents shortened."""
        text = super().__str__()
        return text if len(text) < 4000 else f"{text[:2000]} … {text[-1000:]}"


class MachineError(FluxobsError):
    """A machine's parameters are missing, unknown or impossible."""


class RecordError(FluxobsError):
    """A record, or the description of its channels, is unusable."""


class ObserverError(FluxobsError):
    """An observer setting cannot work."""


class UsageError(FluxobsError, TypeError):
    """Arguments contradict each other, or an argument is missing."""


class ModelError(FluxobsError):
    """A model (relation, immersion, energies, gains, trajectory) is unusable."""
