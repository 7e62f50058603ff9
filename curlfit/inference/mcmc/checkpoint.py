"""Checkpoints of a run: a chain in the making is written now and then."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import numpy as np

from curlfit.inference.mcmc.run import Run

_EVERY = 2.0  # seconds between two checkpoints, at least


class Keeper:
    """Writes a chain in the making now and then, for no more than a fiftieth of the time."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self._next = -np.inf

    def keep(self, run: Run) -> None:
        """Write, if it is time."""
        now = monotonic()
        if self.file is None or now < self._next:
            return
        run.chain().save(self.file, compressed=False)
        after = monotonic()
        self._next = after + max(_EVERY, 50 * (after - now))
