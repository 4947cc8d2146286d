"""Records as arrays."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._extra import load

if TYPE_CHECKING:
    Columns = Mapping[str, NDArray[Any] | list[str | None]]


def _unknown(what: str, name: object, known: Iterable[str]) -> KeyError:
    names = list(known)
    found = get_close_matches(str(name).removeprefix("/singletrack/"), names, 3, 0.5)
    hint = f"did you mean {' or '.join(found)}?" if found else f"there are {', '.join(names)}"
    return KeyError(f"there is no {what} {name!r}: {hint}")


class _Columns(dict[str, Any]):
    def __missing__(self, field: str) -> Any:
        raise _unknown("field", field, self)


class Record(Mapping[str, "Columns"]):
    """A record of a drive: the columns of each topic.

    ``record["tick"]["estimate.yaw_rad"]`` has the shape ``(n,)``. Floats that are absent are
    NaN; integers and truth values of which some are absent are floats. Names (of modes,
    reasons, ...) are lists with ``None``.
    """

    def __init__(self, name: str, topics: dict[str, Any], meta: dict[str, Any]) -> None:
        self._topics = {topic: _Columns(columns) for topic, columns in topics.items()}
        #: The file that was read.
        self.name = name
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
        if topic not in self._topics:
            raise _unknown("topic", topic, self)
        return self._topics[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)

    def __repr__(self) -> str:
        counts = {topic: len(next(iter(columns.values()), ())) for topic, columns in self.items()}
        parts = [f"{self.duration:.2f} s", f"ended: {self.reason or 'no drive'}"]
        parts += [f"{count} {topic}" for topic, count in counts.items() if count]
        if not self.finished:
            parts.append("not finished")
        return f"<Record {self.name!r}: {', '.join(parts)}>"

    @property
    def duration(self) -> float:
        """The time from the start of the record to its last tick, in s; 0 without ticks."""
        return float(self.seconds()[-1]) if self._topics.get("tick") else 0.0

    @property
    def reason(self) -> str | None:
        """Why the last drive ended; ``None`` without one, or if it goes on at the end."""
        ticks: dict[str, Any] = self._topics.get("tick", {})
        modes = list(ticks.get("mode", ()))
        if "driving" not in modes:
            return None
        after = len(modes) - modes[::-1].index("driving")
        reasons: list[str | None] = ticks["reason"][after:]
        return reasons[0] if reasons else None

    def seconds(self, topic: str = "tick", field: str | None = None) -> NDArray[np.float64]:
        """Times of a topic since the start of the record, in s, of the shape ``(n,)``."""
        columns = self[topic]
        if field is None:
            names = ("start_ns", "receive_time_ns", "time_ns")
            field = next(name for name in names if name in columns)
        times = np.asarray(columns[field])
        since = times.astype(np.int64) - self.start_ns[0]
        return np.asarray(since * 1e-9, dtype=np.float64)

    def to_pandas(self, topic: str = "tick") -> Any:
        """A topic as a `pandas.DataFrame`; needs the extra ``pandas``."""
        return load("pandas", "pandas").DataFrame(dict(self[topic]))

    def to_polars(self, topic: str = "tick") -> Any:
        """A topic as a `polars.DataFrame`; needs the extra ``polars``."""
        return load("polars", "polars").DataFrame(dict(self[topic]))


def read(path: str | os.PathLike[str], topics: Sequence[str] | None = None) -> Record:
    """Reads a record (``.mcap``), finished or not.

    Args:
        path: The record.
        topics: The topics to read, such as ``["tick", "telemetry"]``; all if left out.
    """
    names = None if topics is None else list(topics)
    return Record(os.fspath(path), *_native.read_record(os.fspath(path), names))
