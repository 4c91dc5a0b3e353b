"""``python -m fluxobs`` is ``fluxobs``."""

from .cli import main

main()
