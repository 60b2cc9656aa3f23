"""Loop driver: the caller advances the loop a period at a time, or a thread of its own does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError
from allegro_twin.types import Sample

Condition = Callable[[Sample], bool]
CLOSING = 5.0
"""s that a period may still take when somebody closes the hand."""


class LoopThread:
    """Runs samples and lets callers wait for what they wait for.

    In the foreground time passes only while somebody waits, so a simulation is as fast as it goes and repeats itself;
    in the background it passes on its own, as it does for a real hand. An error is raised to whoever waits next; what
    is no HandError comes as a HandFault that names it.
    """

    def __init__(
        self, samples: Iterator[Sample], *, background: bool, release: Callable[[], None] = lambda: None
    ) -> None:
        """`release`: lets go of the hand, in whichever thread turns the loop when it is closed. Idempotent."""
        self._samples, self._release, self._news = samples, release, threading.Condition()
        self._latest = next(samples)
        self._error: HandError | None = None
        self._stopped = False
        self._advancing, self._owner = threading.Lock(), 0  # The thread that holds it.
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
    def error(self) -> HandError | None:
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
        """End the loop and release the hand. Idempotent. Raises LinkError where a period or a listener does not end:
        the thread that it keeps then releases the hand as soon as it can."""
        self._stopped = True
        if self._owner == threading.get_ident() or self._thread is threading.current_thread():
            self._release()  # From a listener: its samples end when it has returned.
            return
        if self._thread is not None:
            self._thread.join(timeout=CLOSING)
            ended = not self._thread.is_alive()
        else:
            ended = self._advancing.acquire(timeout=CLOSING)
        if not ended:
            raise LinkError(
                f"the hand is not closed, and may still push: a period or a listener has not ended within {CLOSING:g} "
                "s; when it ends, its thread lets go of the hand"
            )
        try:
            self._let_go()
        finally:
            if self._thread is None:
                self._advancing.release()

    def _let_go(self) -> None:
        """In the thread that turns the loop, or once nobody does."""
        if (close := getattr(self._samples, "close", None)) is not None:
            close()
        self._release()

    def _advance(self) -> None:
        if not self._advancing.acquire(blocking=False):
            raise ConfigError(
                "another call waits for this hand already: one thread at a time lets its time pass, and no listener "
                "does; open it with background=True for several threads"
            )
        self._owner = threading.get_ident()
        try:
            self._latest = next(self._samples)
        except StopIteration:
            self._error = _ending(None)
            raise self._error from None
        except BaseException as error:
            self._error = _ending(error)
            raise
        finally:
            self._owner = 0
            if self._stopped:
                self._let_go()
            self._advancing.release()

    def _turn(self) -> None:
        try:
            while not self._stopped:
                sample = next(self._samples)
                with self._news:
                    self._latest = sample
                    self._news.notify_all()
        except StopIteration:
            self._end(None)
        except HandError as error:
            self._end(error)
        except BaseException as error:
            self._end(error)
            raise  # Its trace goes to the terminal.
        finally:
            if self._stopped:
                with suppress(HandError):  # `close` lets go once more, and raises it.
                    self._let_go()

    def _end(self, error: BaseException | None) -> None:
        with self._news:
            self._error = _ending(error)
            self._news.notify_all()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._stopped:
            raise HandFault("the hand is closed; open it again")


def _ending(error: BaseException | None) -> HandError:
    """What everybody is told who asks after the loop has ended by an error; None: by its own end."""
    if error is None:
        return HandFault("the hand has ended: nothing more comes from it")
    if isinstance(error, HandError):
        return error
    said = f": {error}" if str(error) else ""
    what = (
        "Ctrl-C" if isinstance(error, KeyboardInterrupt) else f"an error of the program, {type(error).__name__}{said}"
    )
    fault = HandFault(f"the loop has ended by {what}; open the hand again")
    fault.__cause__ = error
    return fault
