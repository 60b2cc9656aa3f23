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
    startup,
    two_processes,
    wire,
)

BENCHMARKS = (loop_cost, inverse_kinematics, startup, memory, wire, bus_cost, deadman, deaths, two_processes, gym)


def main() -> None:
    print(f"{'what':<72}{'measured':>12}{'bar':>10}")
    for benchmark in BENCHMARKS:
        for what, measured, bar, unit in benchmark.figures():
            print(f"{what:<72}{measured:>10.2f} {unit:<2}{bar:>8} {unit}", flush=True)


if __name__ == "__main__":
    main()
