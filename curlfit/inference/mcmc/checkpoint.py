"""Checkpoints of a run: the unfinished chain is written at intervals."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import numpy as np

from curlfit.inference.mcmc.run import Run

_EVERY = 2.0  # least time between two checkpoints, s


class CheckpointWriter:
    """Writes an unfinished chain at intervals, in no more than a fiftieth of the time."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self._next = -np.inf

    def write_if_due(self, run: Run) -> None:
        """Write a checkpoint if one is due."""
        now = monotonic()
        if self.file is None or now < self._next:
            return
        run.chain().save(self.file, compressed=False)
        after = monotonic()
        self._next = after + max(_EVERY, 50 * (after - now))
