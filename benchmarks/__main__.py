"""Run every benchmark and print its figures beside their bars."""

from __future__ import annotations

from benchmarks import gym, inverse_kinematics, loop_cost, memory, startup, wire


def main() -> None:
    print(f"{'what':<64}{'measured':>12}{'bar':>10}")
    for benchmark in (loop_cost, inverse_kinematics, startup, memory, gym, wire):
        for what, measured, bar, unit in benchmark.figures():
            print(f"{what:<64}{measured:>10.2f} {unit:<2}{bar:>8} {unit}")


if __name__ == "__main__":
    main()
