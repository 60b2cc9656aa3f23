"""The process that does a job for another: questions come in, answers go out, until the other is gone."""

from __future__ import annotations

import sys
from multiprocessing.connection import Connection

from allegro_twin.errors import HandError


def serve(line: Connection) -> None:
    """Take the job, then answer. A HandError is an answer."""
    try:
        try:
            work = line.recv().open()
            line.send(None)
            while True:
                question = line.recv()
                line.send(work(question))
        except HandError as error:
            line.send(error)
    except (EOFError, OSError):
        return  # Nobody is there to answer.


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
