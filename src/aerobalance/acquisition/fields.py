"""What the tables of a test set-up are made of."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from aerobalance.io.channel_settings import NotBelow, Number, Strict
from aerobalance.io.text_cells import LARGEST

__all__ = ["Above", "FileName", "Name", "NotBelow", "Number", "Table", "Text"]

Above = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=10_000)]
Name = Annotated[str, Field(min_length=1, max_length=60)]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]


class Table(Strict):
    """A table of a set-up."""
