"""Run every benchmark and print its figures beside their bars."""

from __future__ import annotations

from benchmarks import bus_cost, deadman, inverse_kinematics, loop_cost, memory, startup, two_processes


def main() -> None:
    print(f"{'what':<58}{'measured':>12}{'bar':>10}")
    for benchmark in (loop_cost, inverse_kinematics, startup, memory, bus_cost, deadman, two_processes):
        for what, measured, bar, unit in benchmark.figures():
            print(f"{what:<58}{measured:>10.2f} {unit:<2}{bar:>8} {unit}")


if __name__ == "__main__":
    main()
