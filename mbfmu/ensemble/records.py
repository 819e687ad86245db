"""Storage of the runs of a study: a folder of Parquet files with one row per run, written during the study.

During the study the rows are in parts, each of which is complete or absent; at its end they are one table in
the order of the runs. Therefore a study that was killed can continue.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import secrets
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import mbfmu
from mbfmu.util.errors import UserError, report_write_errors
from mbfmu.util.extras import import_optional
from mbfmu.util.files import replacing, write_text
from mbfmu.util.toml import INTEGER_LIMIT

from .definition import RUN_COLUMNS, Definition, key_of
from .design import Point
from .worker import STATUS_FAILED, STUDY_EXTRA, Outcome

STUDY_FORMAT = 1
STUDY_METADATA_KEY = b"mbfmu.study"  # in the files of runs: the identity of the study
DEFINITION_KEYS = {"identity", "name", "mbfmu", "units", "study"}
DEFINITION_FILE, TABLE_FILE, PARTS_FOLDER, HISTORIES_FOLDER = "study.json", "runs.parquet", "parts", "trajectories"
OTHERS_FILE = "others.parquet"  # runs that were made, and that the study does not ask for now
FINISHED_FILES = "[!.]*.parquet"  # none that a killed process left unfinished
WRITE_INTERVAL, MAX_PART_ROWS = 5.0, 5000  # s between two parts, and rows of one
Row = dict[str, Any]


class Records:
    """The folder of a study.

    Attributes
    ----------
    done
        Measures by the keys of runs.
    """

    def __init__(self, folder: Path, definition: Definition) -> None:
        self.folder, self.definition = folder, definition
        self.identity = definition.identity()
        self.done: dict[str, tuple[float, ...]] = {}
        self.failed = 0
        self._names = [m.name for m in definition.measures]
        self._new: list[Row] = []
        self._kept: list[tuple[str, Any]] = []
        self._last = time.monotonic()
        self._lock_file: int | None = None  # the folder, open and locked
        self._is_new, self._created = False, list[Path]()  # what this process has made of it

    # ---- beginning ---------------------------------------------------------------------------------------------------

    def begin(self, resume: bool) -> None:
        """Make the folder, or go on with what is in it.

        Raises
        ------
        UserError
            There is something else in it, another process makes its runs, or it cannot be written.
        """
        import_optional("pyarrow", STUDY_EXTRA)
        told = self.folder / DEFINITION_FILE
        with report_write_errors(self.folder):
            if resume:
                self._compare()
            # innermost first
            self._created = [path for path in (self.folder, *self.folder.parents) if not path.exists()]
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock()
            if resume:
                self._resume()
            elif any(self.folder.iterdir()):
                more = "it contains a study; continue it with --resume, or choose" if told.exists() else "name"
                raise UserError(f"folder {str(self.folder)!r} is not empty; {more} another")
            content = {"format": STUDY_FORMAT, "mbfmu": mbfmu.__version__, "identity": self.identity}
            content |= {"name": self.definition.target.name, "units": self.definition.units()}
            content |= {"study": self.definition.content, "replaced_inputs": self.definition.target.replaced_inputs}
            self._is_new = not told.exists()
            write_text(told, json.dumps(content, indent=1, default=repr))

    def discard(self) -> None:
        """Remove what :meth:`begin` made if there is no run yet, so that the folder can be used again."""
        if self._is_new and not self._new and not files_of(self.folder, others=True):
            with suppress(OSError):  # others have put something there
                (self.folder / DEFINITION_FILE).unlink(missing_ok=True)
                for path in self._created:
                    path.rmdir()

    def _lock(self) -> None:
        """Lock the folder as long as this process lasts, where its file system has locks."""
        self._lock_file = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(
                f"folder {str(self.folder)!r} belongs to a study that is running in another process; wait until it has "
                "ended, or use another folder"
            ) from error
        except OSError:
            return  # no locks there

    def _resume(self) -> None:
        if not files_of(self.folder, others=True):
            return
        before = read_table(self.folder, others=True)
        keys, failed = (
            before.column("key").to_pylist(),
            [x == STATUS_FAILED for x in before.column("status").to_pylist()],
        )
        columns = [before.column(name).to_pylist() for name in self._names]
        measures = zip(*columns, strict=True) if columns else [()] * len(before)
        kept = read_histories(self.folder, ["key"]) if self.definition.keep else before
        known = set(kept.column("key").to_pylist())
        self.done = {k: own for k, own, f in zip(keys, measures, failed, strict=True) if f or k in known}
        self.failed = sum(failed)

    def _compare(self) -> None:
        before = read_definition(self.folder)
        if before["identity"] != self.identity:
            raise UserError(
                f"folder {str(self.folder)!r} contains another study, of {before['name']!r} by mbfmu "
                f"{before['mbfmu']}: "
                "the scene or the measures differ; choose another folder"
            )

    # ---- rows --------------------------------------------------------------------------------------------------------

    def key(self, point: Point) -> str:
        """Return the key of the run at a point."""
        return key_of(self.identity, point)

    def add(self, outcomes: Sequence[Outcome], points: Sequence[Point]) -> None:
        """Take outcomes of runs at these points; they are written every few seconds."""
        for outcome, point in zip(outcomes, points, strict=True):
            row = {"run": outcome.number, "key": self.key(point), **point}
            row |= dict(zip(self._names, outcome.measures, strict=True))
            row |= {"status": outcome.status, "message": outcome.message}
            row |= {"energy_error": outcome.energy_error, "seconds": outcome.seconds}
            self._new.append(row)
            self.done[row["key"]] = outcome.measures
            self.failed += outcome.status == STATUS_FAILED
            if outcome.kept is not None:
                self._kept.append((row["key"], outcome.kept))
        if time.monotonic() - self._last > WRITE_INTERVAL or len(self._new) >= MAX_PART_ROWS:
            self.write()

    def write(self) -> None:
        """Write what is new as a part."""
        self._last = time.monotonic()
        if not self._new:
            return
        name = f"{self._new[0]['run']:08d}-{secrets.token_hex(4)}.parquet"
        with report_write_errors(self.folder):
            if self._kept:
                write_table(self._histories(), self.folder / HISTORIES_FOLDER / name, self.identity)
            write_table(self._columns(self._new), self.folder / PARTS_FOLDER / name, self.identity)
        self._new, self._kept = [], []

    def close(self) -> None:
        """Write what is new, and let others have the folder."""
        try:
            self.write()
        finally:
            if self._lock_file is not None:
                os.close(self._lock_file)
                self._lock_file = None

    def _columns(self, rows: Sequence[Row]) -> dict[str, list[Any]]:
        varied = list(self.definition.vary)
        names = ("run", "key", *varied, *self._names, *RUN_COLUMNS[2:])
        return {name: storable([row.get(name) for row in rows]) for name in names}

    def _histories(self) -> dict[str, Any]:
        lengths = [len(t) for _, (t, _) in self._kept]
        keys = np.repeat([key for key, _ in self._kept], lengths)
        times, values = (np.concatenate([own[k] for _, own in self._kept]) for k in (0, 1))
        columns = {name: values[:, i] for i, name in enumerate(self.definition.keep)}
        return {"key": keys, "time": times, **columns}

    def finish(self, keys: Sequence[str]) -> None:
        """Write all rows of these keys as one table, in this order, in place of the parts; other rows apart."""
        self.write()
        table = read_table(self.folder, others=True)
        at = {key: place for place, key in enumerate(table.column("key").to_pylist())}
        rows = table.take([at[key] for key in keys])
        rows = rows.set_column(0, "run", [list(range(len(keys)))])
        others = sorted(at[key] for key in at.keys() - set(keys))
        with report_write_errors(self.folder):
            if others:
                write_table(table.take(others), self.folder / OTHERS_FILE, self.identity)
            write_table(rows, self.folder / TABLE_FILE, self.identity)
            if not others:
                (self.folder / OTHERS_FILE).unlink(missing_ok=True)
            shutil.rmtree(self.folder / PARTS_FOLDER, ignore_errors=True)


def storable(values: Sequence[Any]) -> list[Any]:
    """Return a column as a table can hold it: text without halves of characters, whole numbers of 64 bits.

    Larger whole numbers become floating-point numbers, and with them all numbers of their column.
    """
    found = [v.encode("utf-8", "backslashreplace").decode("utf-8") if isinstance(v, str) else v for v in values]
    numbers = [v for v in found if isinstance(v, int | float) and not isinstance(v, bool)]
    if all(isinstance(v, int) and -INTEGER_LIMIT <= v < INTEGER_LIMIT for v in numbers):
        return found
    return [_real(v) if isinstance(v, int) and not isinstance(v, bool) else v for v in found]


def _real(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def write_table(columns: Any, path: Path, identity: str) -> None:
    """Write a table, or columns by their names, as a Parquet file of the study with this identity."""
    arrow, parquet = import_optional("pyarrow", STUDY_EXTRA), import_optional("pyarrow.parquet", STUDY_EXTRA)
    table = arrow.table(columns) if isinstance(columns, dict) else columns
    table = table.replace_schema_metadata({STUDY_METADATA_KEY: identity})
    path.parent.mkdir(exist_ok=True)
    with replacing(path) as unfinished:
        parquet.write_table(table, unfinished)


def read_definition(folder: Path) -> dict[str, Any]:
    """Return the definition of the study in a folder; raises UserError if there is none."""
    try:
        told = json.loads((folder / DEFINITION_FILE).read_text("utf-8"))
    except OSError as error:
        raise UserError(f"folder {str(folder)!r} contains no study: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise UserError(f"{str(folder / DEFINITION_FILE)!r} is damaged: {error}") from error
    if not isinstance(told, dict) or told.get("format") != STUDY_FORMAT or not told.keys() >= DEFINITION_KEYS:
        raise UserError(f"folder {str(folder)!r} contains a study of another version of mbfmu; make the study again")
    return told


def files_of(folder: Path, *, others: bool = False) -> list[Path]:
    """Return the files that rows are in; those that the study does not ask for too."""
    more = [folder / OTHERS_FILE] if others else []
    return [*filter(Path.exists, [folder / TABLE_FILE, *more]), *sorted((folder / PARTS_FOLDER).glob(FINISHED_FILES))]


def read_table(folder: Path, *, others: bool = False) -> Any:
    """Return all rows of a folder in the order of the runs, as a table of pyarrow's.

    Raises
    ------
    UserError
        A file was not written by mbfmu, or no file exists yet.
    """
    identity = read_definition(folder)["identity"]
    tables = [_read(file, identity) for file in files_of(folder, others=others)]
    if not tables:
        raise UserError(f"folder {str(folder)!r} contains no runs yet; start the study with --resume")
    table = _joined(tables).sort_by("run")
    first = np.unique(table.column("key").to_numpy(), return_index=True)[1]
    return table if len(first) == len(table) else table.take(np.sort(first))  # one that was killed may have some twice


def read_histories(folder: Path, columns: list[str] | None = None) -> Any:
    """Return the histories that a folder keeps, or columns of them, as a table of pyarrow's.

    Raises
    ------
    UserError
        A file was not written by mbfmu.
    """
    arrow, identity = import_optional("pyarrow", STUDY_EXTRA), read_definition(folder)["identity"]
    tables = [_read(file, identity, columns) for file in sorted((folder / HISTORIES_FOLDER).glob(FINISHED_FILES))]
    return _joined(tables) if tables else arrow.table({"key": []})


def _read(file: Path, identity: str, columns: list[str] | None = None) -> Any:
    parquet = import_optional("pyarrow.parquet", STUDY_EXTRA)
    try:
        table = parquet.read_table(file, columns=columns)
        table.column("key")
    except Exception as error:  # a file of another kind fails in many ways
        again = "move it to another folder; --resume repeats its runs"
        raise UserError(f"{str(file)!r} is not a table of runs: {error}; {again}") from error
    if (table.schema.metadata or {}).get(STUDY_METADATA_KEY, identity.encode()) != identity.encode():
        raise UserError(f"{str(file)!r} belongs to another study; move it to another folder")
    return table


def _joined(tables: Sequence[Any]) -> Any:
    return import_optional("pyarrow", STUDY_EXTRA).concat_tables(tables, promote_options="permissive")
