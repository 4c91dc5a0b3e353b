"""A benchmark of position observers on shared records: suite, entrants, scores."""

from .entrants import Entrant, entrant
from .scores import Score, Summary, score_entrant, summarise
from .suite import Suite, read_suite, write_suite

__all__ = [
    "Entrant",
    "Score",
    "Suite",
    "Summary",
    "entrant",
    "read_suite",
    "score_entrant",
    "summarise",
    "write_suite",
]
