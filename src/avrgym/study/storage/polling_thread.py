"""A thread that reads the database of a study at an interval."""

import threading
from contextlib import suppress
from typing import Self

from avrgym.study.storage.state_transitions import StudyError


class PollingThread:
    """Context manager: a thread that calls ``poll`` at an interval. Subclasses define ``poll``.

    Errors of the database are ignored: other functions report an unreadable database.
    """

    def __init__(self, name: str, interval_s: float) -> None:
        self._interval_s = interval_s
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def poll(self) -> None:
        """Read the database."""
        raise NotImplementedError

    def start(self) -> None:
        """Start the thread. It calls ``poll`` until ``close``."""
        self._thread.start()

    def close(self) -> None:
        """End the thread after its current call."""
        self._closed.set()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._thread.join()

    def _run(self) -> None:
        while not self._closed.wait(self._interval_s):
            with suppress(StudyError):
                self.poll()
