"""Drivers for hands on CAN and serial lines, and virtual hands that speak the same protocols."""
