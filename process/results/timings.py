"""How long the stages of a reconstruction take, for the report."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Timings:
    """Seconds per stage, summed."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Elapsed time."""
    processor_s: dict[str, float] = field(default_factory=dict)
    """Processor time of all threads of this process: the cost, however busy the machine is."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to ``name``."""
        start, start_processor = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            self.processor_s[name] = self.processor_s.get(name, 0.0) + time.process_time() - start_processor

    def rounded(self) -> tuple[dict[str, float], dict[str, float]]:
        """Both to a microsecond, for a report."""
        clock, processor = ({k: round(v, 6) for k, v in part.items()} for part in (self.seconds, self.processor_s))
        return clock, processor
