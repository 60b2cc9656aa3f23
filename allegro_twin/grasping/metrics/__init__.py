"""How good a grasp is by its contacts alone: pure functions of arrays, in docs/reference/grasp_metrics.md with their
equations."""
