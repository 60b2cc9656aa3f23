"""How good a grasp is by its contacts alone: pure functions of arrays, in docs/evaluation.md with their equations."""
