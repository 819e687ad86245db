"""Who makes the runs: the workers of a Dask cluster, one on this machine or one that is there.

Runs travel in batches of about half a second, so that small ones are not drowned in messages, and no more batches are
under way than keep all workers busy, so that memory does not grow with a study.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, suppress
from itertools import islice
from math import inf, nan
from multiprocessing import current_process
from types import TracebackType
from typing import Any, Self

import mbfmu
from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional
from mbfmu.util.processes import count_processors

from .design import Point
from .worker import STATUS_FAILED, STUDY_EXTRA, FmuJob, ModelJob, Outcome, run_batch

BATCH_TIME = 0.5  # s of work
# s by the clock, after which a batch that takes longer than was thought comes back with what is done
MAX_BATCH_TIME = 2.0
MAX_BATCH_RUNS = 1000  # runs of a batch
BATCHES_PER_WORKER = 3  # batches under way for each worker
SCHEDULER_TIMEOUT = 15.0  # s to wait for a scheduler, and for a first worker
WORKER_CHECK_INTERVAL = 5.0  # s between two looks at whether there is a worker, while no batch comes
WORKER_WARNING_INTERVAL = 60.0  # s between two sentences that say there is none
POLL_INTERVAL = 0.02  # s
KILLED_MESSAGE = "the process of this run ended unexpectedly in all attempts"

log = logging.getLogger(__name__)  # written to stderr by default
ADDRESS_PATTERN = re.compile(r"((tcp|tls|ws|wss|ucx)://)?[^\s/]+:\d+")


class Workers:
    """Workers, as long as they are needed: a pool of processes on this machine, or those of a scheduler.

    Parameters
    ----------
    scheduler
        Address of a scheduler, such as ``tcp://host:8786``; empty: a pool of this study's own.
    count
        Processes of the pool; 0: as many as this process may use processors.

    Raises
    ------
    UserError
        Dask is not installed, the scheduler does not answer or has no worker, or a worker lacks this mbfmu.
    """

    def __init__(self, scheduler: str = "", count: int = 0) -> None:
        distributed = import_optional("distributed", STUDY_EXTRA)
        if isinstance(count, bool) or not isinstance(count, int) or count < 0:
            raise UserError(f"workers is {count!r}; allowed: a number of processes, or 0 for one per processor")
        if scheduler and not ADDRESS_PATTERN.fullmatch(scheduler):
            raise UserError(f"scheduler is {scheduler!r}; allowed: an address such as 'tcp://host:8786'")
        self._cluster: Any = None
        self._where = f"scheduler {scheduler!r}" if scheduler else "the pool of workers"
        self._quiet = ExitStack()  # losses are reported here, without tracebacks
        self._quiet.enter_context(distributed.utils.silence_logging_cmgr(logging.CRITICAL))
        try:
            if scheduler:
                self._client = distributed.Client(scheduler, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
            else:
                count = count or count_processors()
                with import_optional("dask", STUDY_EXTRA).config.set({"distributed.scheduler.allowed-failures": 1}):
                    self._cluster = distributed.LocalCluster(
                        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0,
                        silence_logs=logging.CRITICAL, preload=["mbfmu.ensemble.worker_preload"],
                    )  # fmt: skip
                self._client = distributed.Client(self._cluster, set_as_default=False)
            self._client.wait_for_workers(1, timeout=SCHEDULER_TIMEOUT)
        except Exception as error:  # an address may be wrong in many ways
            self.close()
            told = f"{self._where} does not answer within {SCHEDULER_TIMEOUT:g} s, or has no worker"
            raise UserError(f"{told}: {error or type(error).__name__}") from error
        self._check_versions()

    def _check_versions(self) -> None:
        def version() -> str:  # has no module, so that it travels where there is no mbfmu
            try:
                import mbfmu as there
            except ImportError as error:
                return f"none ({error})"
            return there.__version__

        told = self._client.run(version)
        wrong = [f"{worker} has {found}" for worker, found in told.items() if found != mbfmu.__version__]
        if wrong:
            self.close()
            raise UserError(f"workers lack mbfmu {mbfmu.__version__}: {'; '.join(wrong)}; install it there")

    def run(
        self, job: ModelJob | FmuJob, points: Iterable[tuple[int, Point]], seconds: float
    ) -> Iterator[list[Outcome]]:
        """Make the runs of these numbers and points, and yield outcomes of finished batches.

        ``seconds`` is about what a run takes. What a worker leaves undone when it dies, others do; a run in which its
        process dies again and again has failed. Where there is no worker for a while, that is logged as a warning.

        Raises
        ------
        UserError
            A worker cannot make such runs at all, or the scheduler has gone.
        """
        distributed = import_optional("distributed", STUDY_EXTRA)
        waiting, under_way = iter(points), distributed.as_completed(loop=self._client.loop)
        batches: dict[str, list[tuple[int, Point]]] = {}
        suspects: list[tuple[int, Point]] = []  # runs that were with a worker that died: each is tried alone in the end
        alone: set[int] = set()
        shared = self._client.submit(_job_of_task, job, key=f"study-{job.identity}")

        def send(runs: list[tuple[int, Point]]) -> None:
            future = self._client.submit(run_batch, shared, runs, MAX_BATCH_TIME, pure=False)
            batches[future.key] = runs
            under_way.add(future)

        def send_more() -> None:
            size = min(max(round(BATCH_TIME / seconds), 1), MAX_BATCH_RUNS)
            while len(batches) < BATCHES_PER_WORKER * self.count() and (runs := list(islice(waiting, size))):
                send(runs)
            if not batches and suspects:
                alone.add(suspects[0][0])
                send([suspects.pop(0)])

        send_more()
        while not under_way.is_empty():
            self._wait(under_way, batches)
            future = next(under_way)
            runs = batches.pop(future.key)
            try:
                outcomes = future.result()
            except distributed.KilledWorker:
                if runs[0][0] not in alone:
                    suspects += runs
                    send_more()
                    continue
                why = (
                    f"{KILLED_MESSAGE}, or it took longer than the time_limit, {job.time_limit:g} s"
                    if job.time_limit
                    else KILLED_MESSAGE
                )
                outcomes = [Outcome(runs[0][0], (), STATUS_FAILED, why, nan, 0.0, None)]
            except UserError:
                raise
            except (CancelledError, Exception) as error:
                if future.status == "error":
                    told = f"{type(error).__name__}: {error}"
                    raise UserError(f"a worker cannot run this study: {told}") from error
                raise self._worker_error(error) from error
            finally:
                future.release()
            spent = sum(outcome.seconds for outcome in outcomes) / len(outcomes)
            seconds = 0.5 * (seconds + max(spent, 1e-6))
            if rest := runs[len(outcomes) :]:
                send(rest)
            send_more()
            yield outcomes

    def _wait(self, under_way: Any, batches: Mapping[str, Sequence[Any]]) -> None:
        """Wait for a batch; say meanwhile where there is no worker that could make it."""
        look, told = time.monotonic() + WORKER_CHECK_INTERVAL, -inf
        while not under_way.has_ready():
            time.sleep(POLL_INTERVAL)
            now = time.monotonic()
            if now < look:
                continue
            look = now + WORKER_CHECK_INTERVAL
            if self._workers() or under_way.has_ready():
                told = -inf
            elif now - told > WORKER_WARNING_INTERVAL:
                told = now
                runs = sum(map(len, batches.values()))
                log.warning(
                    "%s has no worker: %d runs wait for one; start one, or end this and resume", self._where, runs
                )

    def _workers(self) -> int:
        """Return how many workers there are now."""
        try:
            return len(self._client.scheduler_info(n_workers=-1)["workers"])
        except (CancelledError, Exception) as error:  # a connection is lost in many ways
            raise self._worker_error(error) from error

    def _worker_error(self, error: BaseException) -> UserError:
        told = str(error).splitlines() or [type(error).__name__]
        return UserError(f"{self._where} has stopped: {told[0]}; start another scheduler and continue with --resume")

    def count(self) -> int:
        """Return how many workers there are now, one at least."""
        return max(1, self._workers())

    def close(self) -> None:
        """Let the pool go, or leave the scheduler as it was."""
        for own in (getattr(self, "_client", None), self._cluster):
            if own is not None:
                with suppress(Exception):  # they may have gone before
                    own.close(timeout=5)
        self._quiet.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()


def check_place() -> None:
    """Refuse a study in a process of a pool, which imports the script that made it."""
    if getattr(current_process(), "_inheriting", False):
        raise UserError('put what starts a study under `if __name__ == "__main__":`: its workers import the script')


def _job_of_task(job: ModelJob | FmuJob) -> ModelJob | FmuJob:
    """Return a job: a separate task, so that it is sent to a worker once, and again if it was lost."""
    return job


def pad_outcomes(outcomes: Sequence[Outcome], measures: int) -> list[Outcome]:
    """Return outcomes with as many measures each."""
    return [o if len(o.measures) == measures else o._replace(measures=(nan,) * measures) for o in outcomes]
