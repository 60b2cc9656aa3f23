"""`python -m benchmarks`: every figure as a ratio or a count, beside its bar."""

from __future__ import annotations

from benchmarks import (
    bus_cost,
    deadman,
    deaths,
    gym,
    inverse_kinematics,
    loop_cost,
    memory,
    mirror,
    perception,
    polled_line,
    servo_line,
    startup,
    sweeping,
    two_processes,
    wire,
)
from benchmarks.figures import show

BENCHMARKS = (
    loop_cost,
    inverse_kinematics,
    startup,
    memory,
    wire,
    mirror,
    perception,
    bus_cost,
    servo_line,
    polled_line,
    deadman,
    deaths,
    two_processes,
    gym,
    sweeping,
)


def main() -> None:
    print(f"{'what':<72}{'measured':>12}{'bar':>10}")
    for benchmark in BENCHMARKS:
        show(benchmark.figures())


if __name__ == "__main__":
    main()
