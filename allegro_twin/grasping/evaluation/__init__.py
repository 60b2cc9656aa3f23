"""Evaluation campaigns: their trials, tables and reports."""
