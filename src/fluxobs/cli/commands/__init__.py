"""One file a command."""

from .check import check
from .compare import compare
from .demo import demo
from .estimate import estimate
from .export import export
from .identify import identify
from .machines import machines
from .reproduce import reproduce

__all__ = [
    "check",
    "compare",
    "demo",
    "estimate",
    "export",
    "identify",
    "machines",
    "reproduce",
]
