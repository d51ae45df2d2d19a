"""Storing beside the loop: what happens is stored in order, and whoever asks for it goes on meanwhile."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor


class StoringThread(ThreadPoolExecutor):
    """The one thread that stores.

    On leaving its context it drops what has not begun: whoever had to know it stored has waited for it before, and a
    database that is busy for minutes keeps no program from ending.
    """

    def __init__(self) -> None:
        super().__init__(1, "storing")

    def __exit__(self, *_: object) -> None:
        self.shutdown(cancel_futures=True)


class Storing:
    """Hands what is to be stored to an executor of one thread."""

    def __init__(self, thread: Executor) -> None:
        """``thread`` does what is submitted in order: a pool of one thread, or at once in simulated time."""
        self._thread = thread
        self._asked: deque[Future[None]] = deque()

    def ask(self, store: Callable[[], None]) -> None:
        """Have something stored after all that was asked before; ``done`` tells how that went."""
        self._asked.append(self.submit(store))

    def submit(self, store: Callable[[], None]) -> Future[None]:
        """Have something stored after all that was asked before; only the future tells how that went."""
        return self._thread.submit(store)

    def done(self) -> bool:
        """Whether all is on disk that was asked so far; raises once what could not be."""
        failures = [error for future in self._take_done() if (error := future.exception())]
        if failures:
            raise failures[0]
        return not self._asked

    def _take_done(self) -> Iterator[Future[None]]:
        while self._asked and self._asked[0].done():
            yield self._asked.popleft()
