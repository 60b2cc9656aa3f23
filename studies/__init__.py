"""Experiments on the public API of allegro_twin, each registered before it runs."""
