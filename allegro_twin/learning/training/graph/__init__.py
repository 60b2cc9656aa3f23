"""A policy as a graph of operations: written as ONNX, read back, and what it makes of a goal."""
