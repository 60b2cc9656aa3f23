"""The process that leaves a hand limp when the program that drives it dies or stalls.

It runs as a package of its own, isolated, and imports nothing but the standard library, so that it starts in 50 ms; and
it knows frames, not hands. Standard input is a socket to the program: one line of JSON (`Orders`), then a byte whenever
there is news; its end is the program's end. The heartbeat is in shared memory, in these cells.
"""

BEAT, PATIENCE, ARMED, VOICE, CUTS, SAID, OWED = range(7)
"""Cells of the shared memory: when the program called last and how long it may stay away, ns on the monotonic clock (0:
for ever); whether the motors may be on; what the program wants said; how often the hand was cut off, and which of these
times it was confirmed; whether the hand is being told, and this has not come to its end."""
SPEAK, HUSH = 1, 2
"""VOICE: leave the hand limp now; be silent, for the program speaks to the hand itself."""
