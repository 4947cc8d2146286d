"""Records as arrays."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native

if TYPE_CHECKING:
    Columns = Mapping[str, NDArray[Any] | list[str | None]]


class Record(Mapping[str, "Columns"]):
    """A record of a drive: the columns of each topic.

    ``record["tick"]["estimate.yaw_rad"]`` has the shape ``(n,)``. Floats that are absent are
    NaN; integers and truth values of which some are absent are floats. Names (of modes,
    reasons, ...) are lists with ``None``.
    """

    def __init__(self, topics: dict[str, Any], meta: dict[str, Any]) -> None:
        self._topics = topics
        #: The configuration of the drive, as TOML.
        self.configuration: str = meta["configuration"]
        #: Versions of the programs that wrote it.
        self.software: dict[str, str] = meta["software"]
        #: Seed of the simulation, if there was one.
        self.seed: int | None = meta["seed"]
        #: Start of the record on the monotonic and on the wall clock, in ns.
        self.start_ns: tuple[int, int] = (meta["start_monotonic_ns"], meta["start_wall_ns"])
        #: Whether the record is complete.
        self.finished: bool = meta["finished"]
        #: The damage at which reading stopped; ``None`` without.
        self.damage: str | None = meta["damage"]

    def __getitem__(self, topic: str) -> Columns:
        columns: Columns = self._topics[topic]
        return columns

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)

    def seconds(self, topic: str = "tick", field: str | None = None) -> NDArray[np.float64]:
        """Times of a topic since the start of the record, in s, of the shape ``(n,)``."""
        columns = self[topic]
        if field is None:
            names = ("start_ns", "receive_time_ns", "time_ns")
            field = next(name for name in names if name in columns)
        times = np.asarray(columns[field])
        since = times.astype(np.int64) - self.start_ns[0]
        return np.asarray(since * 1e-9, dtype=np.float64)

    def pandas(self, topic: str = "tick") -> Any:
        """A topic as a `pandas.DataFrame`, if pandas is installed."""
        import pandas

        return pandas.DataFrame(dict(self[topic]))

    def polars(self, topic: str = "tick") -> Any:
        """A topic as a `polars.DataFrame`, if polars is installed."""
        import polars

        return polars.DataFrame(dict(self[topic]))


def read(path: str | os.PathLike[str], topics: Sequence[str] | None = None) -> Record:
    """Reads a record (``.mcap``), finished or not.

    Args:
        path: The record.
        topics: The topics to read, such as ``["tick", "telemetry"]``; all if left out.
    """
    names = None if topics is None else list(topics)
    return Record(*_native.read_record(os.fspath(path), names))
