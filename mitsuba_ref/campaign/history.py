"""The history of a campaign: one SQLite file of runs, the units they have, and the failures of these."""

import contextlib
import json
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from caster.system.atomic_files import OutputError
from mitsuba_ref.campaign.units import SUBJECT, Result, Unit
from mitsuba_ref.reference.store import key_of

Row = dict[str, Any]  # of a query, by column

APPLICATION, VERSION = 0x72617963, 1  # in the header of the file
WAIT_SECONDS = 10.0  # for another process that writes
RUNNING, COMPLETE, BUDGET, INTERRUPTED = "running", "complete", "budget", "interrupted"  # states of a run

# A unit belongs to each run that has it under the same key; the first of them computed it. Types and conditions are
# checked when a file is opened.
SCHEMA = f"""
CREATE TABLE runs (
    id INTEGER PRIMARY KEY, identity TEXT NOT NULL, state TEXT NOT NULL, started TEXT NOT NULL, ended TEXT,
    code TEXT NOT NULL, git TEXT NOT NULL, machine TEXT NOT NULL CHECK (json_type(machine) = 'object'),
    campaign TEXT NOT NULL, units INTEGER NOT NULL
) STRICT;
CREATE TABLE units (
    key TEXT PRIMARY KEY, name TEXT NOT NULL, kind TEXT NOT NULL, subject TEXT NOT NULL, grouped TEXT NOT NULL,
    parameters TEXT NOT NULL, rays INTEGER NOT NULL, hits INTEGER NOT NULL, agree INTEGER NOT NULL,
    counts TEXT NOT NULL CHECK (json_type(counts) = 'object'), failing INTEGER NOT NULL, seconds REAL NOT NULL,
    processor TEXT NOT NULL, finished TEXT NOT NULL, computed_by INTEGER NOT NULL
) STRICT;
CREATE TABLE failures (
    key TEXT NOT NULL, side TEXT NOT NULL, cause TEXT NOT NULL, what TEXT NOT NULL, times INTEGER NOT NULL,
    replay TEXT NOT NULL, scene TEXT NOT NULL
) STRICT;
CREATE TABLE run_units (run INTEGER NOT NULL, key TEXT NOT NULL, PRIMARY KEY (run, key)) STRICT, WITHOUT ROWID;
CREATE INDEX failures_of_unit ON failures (key);
CREATE INDEX runs_of_unit ON run_units (key);
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
"""


class History:
    """An open history. Every method may be called from any thread, and raises OutputError. Use it as a context."""

    def __init__(self, path: str | Path, *, create: bool = False) -> None:
        """create: make the file if there is none. Raises OutputError for a file that is no history, or damaged."""
        self.path = Path(path)
        self._lock = threading.Lock()
        new = not self.path.exists()
        if not (self.path.is_file() or (create and new)):
            raise OutputError(f"{path}: expected the history of a campaign, found no such file; a run writes it")
        try:
            with self._errors():
                self.database = sqlite3.connect(
                    self.path, timeout=WAIT_SECONDS, check_same_thread=False, isolation_level=None
                )
                self.database.row_factory = sqlite3.Row
                if create and not self.database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                    self.database.executescript(f"BEGIN IMMEDIATE; {SCHEMA} COMMIT;")
                pragmas = "SELECT application_id, user_version FROM pragma_application_id, pragma_user_version"
                if tuple(self.database.execute(pragmas).fetchone()) != (APPLICATION, VERSION):
                    raise OutputError(
                        f"{path}: expected the history of a campaign, of version {VERSION}; this is another database"
                    )
        except OutputError:
            if new:  # a full disk
                self.path.unlink(missing_ok=True)
            raise

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:  # a full disk, no permission, a lock
            raise OutputError(f"{self.path}: cannot be used: {error}; what was finished before is kept") from error
        except sqlite3.DatabaseError as error:
            what = f"{self.path}: not a history of a campaign, or a damaged one: {error}"
            raise OutputError(f"{what}; move it away, and the next run begins a new one") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.database.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction: all of it is on the disk at the end, or nothing."""
        with self._lock, self._errors(), self.database:
            self.database.execute("BEGIN IMMEDIATE")
            yield self.database

    def rows(self, query: str, *values: Any) -> list[Row]:
        """The rows of a query, by column."""
        with self._lock, self._errors():
            return [dict(row) for row in self.database.execute(query, values)]

    def units(self, run: int) -> list[Row]:
        """The finished units of a run."""
        return self.rows("SELECT units.* FROM run_units JOIN units USING (key) WHERE run = ? ORDER BY name", run)

    def failures(self, side: str, run: int, *, before: bool = False) -> dict[tuple[str, str], Row]:
        """Failures of one side by unit and cause: the first of each cause, with the number of all.

        before: those of each unit in the last run before this one that finished it.
        """
        runs = "WHERE run < ? GROUP BY name" if before else "WHERE run = ? GROUP BY name"
        rows = self.rows(
            "SELECT key, name, grouped, cause, what, replay, scene, sum(times) AS times, min(failures.rowid) AS row "
            "FROM run_units JOIN units USING (key) JOIN failures USING (key) WHERE side = ? AND (name, run) IN "
            f"(SELECT name, max(run) FROM run_units JOIN units USING (key) {runs}) GROUP BY key, cause ORDER BY row",
            side,
            run,
        )
        return {(row["name"], row["cause"]): row for row in rows}

    # ---- a run ----

    def begin(self, units: Iterable[Unit], about: Mapping[str, str]) -> tuple[int, set[str]]:
        """The run with these units, and the keys of those that are finished.

        The last run goes on if it is of the same units; else a new one begins. about: code, git, machine, campaign.
        """
        keys = sorted(unit.key for unit in units)
        identity = key_of(keys)
        with self._writing() as database:
            last = database.execute("SELECT id, identity FROM runs ORDER BY id DESC LIMIT 1").fetchone()
            if last and last["identity"] == identity:
                run = int(last["id"])
                database.execute("UPDATE runs SET state = ? WHERE id = ?", (RUNNING, run))
            else:
                inserted = database.execute(
                    "INSERT INTO runs (identity, state, started, code, git, machine, campaign, units) "
                    "VALUES (:identity, :state, :started, :code, :git, :machine, :campaign, :units)",
                    {**about, "identity": identity, "state": RUNNING, "started": now(), "units": len(keys)},
                )
                run = int(inserted.lastrowid or 0)
            found = {key for (key,) in database.execute("SELECT key FROM units")}.intersection(keys)
            database.executemany("INSERT OR IGNORE INTO run_units VALUES (?, ?)", ((run, key) for key in found))
        return run, found

    def record(self, run: int, unit: Unit, result: Result) -> None:
        """Add a finished unit."""
        row = (
            unit.key,
            unit.name,
            unit.kind,
            unit.subject.name,
            unit.group,
            json.dumps(unit.parameters),
            result.rays,
            result.hits,
            result.agree,
            json.dumps(dict(result.counts), sort_keys=True),
            sum(failure.side == SUBJECT for failure in result.failures),
            result.seconds,
            result.processor,
            now(),
            run,
        )
        with self._writing() as database:
            added = database.execute(f"INSERT OR IGNORE INTO units VALUES ({', '.join('?' * len(row))})", row)
            if added.rowcount:  # else another run at the same time was earlier
                database.executemany(
                    "INSERT INTO failures VALUES (?, ?, ?, ?, ?, ?, ?)", ((unit.key, *each) for each in result.failures)
                )
            database.execute("INSERT OR IGNORE INTO run_units VALUES (?, ?)", (run, unit.key))

    def end(self, run: int, state: str) -> None:
        """Record how a run ended, for now."""
        with self._writing() as database:
            database.execute("UPDATE runs SET state = ?, ended = ? WHERE id = ?", (state, now(), run))


def now() -> str:
    """The time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")
