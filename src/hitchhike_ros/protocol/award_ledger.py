"""What drivers earned, in one SQLite file: each ride once, however often it is credited and whoever restarts meanwhile.

Several robots of one machine may share a file: it is opened for one operation at a time, each a transaction.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

from hitchhike_ros.core.errors import CreditError, LedgerError, LedgerFormatError

FILE_NAME = "hitchhike_awards.sqlite"
_EXPECTED = "an award ledger of hitchhike_ros"
# Of the file's header; SQLite keeps the first for telling files of one program from those of others.
_APPLICATION_ID, _VERSION = 0x48484B45, 1
# STRICT, since a column of SQLite otherwise takes values of any type.
_SCHEMA = """
CREATE TABLE awards (
    driver TEXT NOT NULL,
    hitchhiker TEXT NOT NULL,
    ride_id TEXT NOT NULL,
    ride_m REAL NOT NULL,
    points REAL NOT NULL,
    time REAL NOT NULL,
    PRIMARY KEY (driver, ride_id, hitchhiker)
) STRICT, WITHOUT ROWID
"""
_INSERT = "INSERT INTO awards VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (driver, ride_id, hitchhiker) DO NOTHING"
_SELECT = (
    "SELECT driver, hitchhiker, ride_id, ride_m, points, time FROM awards ORDER BY time, driver, ride_id, hitchhiker"
)


@dataclass(frozen=True)
class Credit:
    """The points of a driver for the metres that a hitchhiker rode; ``time`` is when it got them, in s since 1970."""

    driver: str
    hitchhiker: str
    ride_id: str
    ride_m: float
    points: float
    time: float

    @property
    def key(self) -> tuple[str, str, str]:
        """What there is one credit for."""
        return self.driver, self.ride_id, self.hitchhiker


@dataclass(frozen=True)
class Total:
    """All that a driver earned."""

    driver: str
    rides: int
    ride_m: float
    points: float


def totals(credits: Iterable[Credit]) -> list[Total]:
    """One total a driver, most points first."""
    of: dict[str, list[Credit]] = {}
    for credit in credits:
        of.setdefault(credit.driver, []).append(credit)
    found = [
        Total(driver, len(own), math.fsum(c.ride_m for c in own), math.fsum(c.points for c in own))
        for driver, own in of.items()
    ]
    return sorted(found, key=lambda total: (-total.points, total.driver))


class AwardLedger:
    """The credits in the file ``path``, which is made with the first of them."""

    def __init__(self, path: Path | str, busy_timeout_s: float = 5.0) -> None:
        """``busy_timeout_s`` of wall time: how long an operation waits for other processes that use the file."""
        self.path = Path(path).absolute()
        self._busy_timeout_s = busy_timeout_s

    def credit(self, credit: Credit) -> bool:
        """Write down a credit; False where that ride is credited already. On return it outlives a loss of power.

        Raises:
            CreditError: a number is not finite or below 0.
            LedgerError: the file cannot be written now: nothing is credited.
            LedgerFormatError: the file is damaged or no ledger; it stays as it is.
        """
        for field in ("ride_m", "points", "time"):
            value = getattr(credit, field)
            if not 0.0 <= value < math.inf:
                raise CreditError(self.path, field, value, "a finite number of at least 0")
        with self._transaction(writes=True) as db:
            return bool(db.execute(_INSERT, astuple(credit)).rowcount)

    def credits(self) -> list[Credit]:
        """All credits, oldest first.

        Raises:
            LedgerError: there is no such file, or it cannot be read now.
            LedgerFormatError: the file is damaged or no ledger.
        """
        with self._transaction(writes=False) as db:
            return [Credit(*row) for row in db.execute(_SELECT)] if self._is_ledger(db) else []

    def check(self) -> None:
        """Make the file if it is missing, and see that it can be written.

        Raises:
            LedgerError, LedgerFormatError: as :meth:`credit`.
        """
        with self._transaction(writes=True):
            pass

    @contextmanager
    def _transaction(self, writes: bool) -> Iterator[sqlite3.Connection]:
        """What is done to the file is done whole or not at all. One that ``writes`` finds a ledger, made if need be."""
        expected = "a file that can be written" if writes else "an existing file that can be read"
        db: sqlite3.Connection | None = None
        try:
            if writes:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            elif not self.path.exists():
                raise LedgerError(self.path, "", "missing", expected)
            uri = f"{self.path.as_uri()}?mode={'rwc' if writes else 'rw'}"  # a reader, too, undoes what a crash left
            db = sqlite3.connect(uri, timeout=self._busy_timeout_s, isolation_level=None, uri=True)
            db.execute("PRAGMA synchronous = EXTRA")
            db.execute("BEGIN IMMEDIATE" if writes else "BEGIN")
            if writes and not self._is_ledger(db):
                db.execute(_SCHEMA)
                db.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
                db.execute(f"PRAGMA user_version = {_VERSION}")
            yield db
            db.execute("COMMIT")
        except sqlite3.OperationalError as exc:
            raise LedgerError(self.path, "", str(exc), expected) from exc
        except sqlite3.DatabaseError as exc:
            raise LedgerFormatError(self.path, "", str(exc), _EXPECTED) from exc
        except FileExistsError as exc:
            raise LedgerError(self.path, "", f"below {self.path.parent}, which is no folder", expected) from exc
        except OSError as exc:
            raise LedgerError(self.path, "", exc.strerror, expected) from exc
        finally:
            if db is not None:
                db.close()  # what is not committed is undone

    def _is_ledger(self, db: sqlite3.Connection) -> bool:
        """Whether this is a sound ledger; False for an empty file, which a crash may leave of the very first credit.

        Raises:
            LedgerFormatError: it is neither.
        """
        application, version = (db.execute(f"PRAGMA {n}").fetchone()[0] for n in ("application_id", "user_version"))
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")]
        if not tables and application == version == 0:
            return False
        if application != _APPLICATION_ID or "awards" not in tables:
            raise LedgerFormatError(self.path, "", "a database of another program", _EXPECTED)
        if version != _VERSION:
            raise LedgerFormatError(self.path, "version", version, str(_VERSION))
        if (found := db.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
            raise LedgerFormatError(self.path, "", found, _EXPECTED)
        return True
