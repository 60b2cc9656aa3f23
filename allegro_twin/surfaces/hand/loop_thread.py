"""Who turns the loop: the caller, a period at a time, or a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

from allegro_twin.errors import ConfigError, HandError, HandFault
from allegro_twin.types import Sample

Condition = Callable[[Sample], bool]
_CLOSING = 1.0  # s that a period may still take, and what a listener that closes the hand waits for in vain.


class LoopThread:
    """Runs samples and lets callers wait for what they wait for.

    In the foreground time passes only while somebody waits, so a simulation is as fast as it goes and repeats itself;
    in the background it passes on its own, as it does for a real hand. An error is raised to whoever waits next;
    there what is no HandError comes as a HandFault that names it.
    """

    def __init__(self, samples: Iterator[Sample], *, background: bool) -> None:
        self._samples, self._news = samples, threading.Condition()
        self._latest = next(samples)
        self._error: BaseException | None = None
        self._stopped = False
        self._advancing = threading.Lock()
        self._thread: threading.Thread | None = None
        if background:
            self._thread = threading.Thread(target=self._turn, name="allegro_twin", daemon=True)
            self._thread.start()

    @property
    def latest(self) -> Sample:
        """The newest sample. Raises what ended the loop, if anything did."""
        with self._news:
            self._check()
            return self._latest

    @property
    def error(self) -> BaseException | None:
        """What ended the loop, if anything did."""
        return self._error

    def wait(self, condition: Condition) -> Sample:
        """Let time pass until a sample fulfils the condition. Raises what ended the loop; ConfigError to whoever cannot
        wait: a listener, and in the foreground a second thread."""
        if self._thread is None:
            while not condition(self._latest):
                self._check()
                self._advance()
            return self._latest
        if self._thread is threading.current_thread():
            raise ConfigError("a listener cannot wait: time passes after it has returned; ask with wait=False")
        with self._news:
            while not condition(self._latest):
                self._check()
                self._news.wait(timeout=1.0)
            return self._latest

    def close(self) -> None:
        """End the loop. Idempotent."""
        self._stopped = True
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5.0)
        close = getattr(self._samples, "close", None)
        if close is None or (self._thread is not None and self._thread.is_alive()):
            return
        if self._advancing.acquire(timeout=_CLOSING):  # Whoever waits in the foreground ends at the next period.
            try:
                close()
            finally:
                self._advancing.release()

    def _advance(self) -> None:
        if not self._advancing.acquire(blocking=False):
            raise ConfigError(
                "another call waits for this hand already: one thread at a time lets its time pass, and no listener "
                "does; open it with background=True for several threads"
            )
        try:
            self._latest = next(self._samples)
        except StopIteration:
            self._error = HandFault("the hand has ended: nothing more comes from it")
            raise self._error from None
        except HandError as error:
            self._error = error
            raise
        finally:
            self._advancing.release()

    def _turn(self) -> None:
        while not self._stopped:
            try:
                sample = next(self._samples)
            except StopIteration:
                self._end(HandFault("the hand has ended: nothing more comes from it"))
                return
            except HandError as error:
                self._end(error)
                return
            except BaseException as error:
                # Whoever waits would wait for ever; the thread's own trace goes to the terminal.
                fault = HandFault(f"the loop has ended by an error of the program, {type(error).__name__}: {error}")
                fault.__cause__ = error
                self._end(fault)
                raise
            with self._news:
                self._latest = sample
                self._news.notify_all()

    def _end(self, error: HandError) -> None:
        with self._news:
            self._error = error
            self._news.notify_all()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._stopped:
            raise HandFault("the hand is closed; open it again")
