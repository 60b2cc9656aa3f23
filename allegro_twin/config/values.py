"""Kinds of value that several blocks of a config take."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

PerJoint = float | list[float]
"""One value for every joint, or one each."""
Positive = Annotated[float, Field(gt=0)]
Vector3 = tuple[float, float, float]
