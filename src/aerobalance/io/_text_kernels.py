"""Compiled loop over the cells of a text table: numbers written plainly, and nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.compiled import compiled

LARGEST_WHOLE = 1 << 53  # up to here whole numbers are floats
MOST_DIGITS = 18  # that a whole number of 64 bits always holds
POWERS = np.array([float(f"1e{power}") for power in range(23)])  # all that are floats exactly: one rounding in the end


@compiled()
def plain_numbers(
    text: NDArray[np.uint8], separator: int, decimal: int, places: NDArray[np.int64], out: NDArray[np.float64]
) -> int:
    """Put the cells of a table (bytes) in place: column i into row places[i] of out, none where that is below zero.

    The number of rows of text; below zero where a cell is no number, needs more than one rounding, or is one too many
    or too few. A number is right to the last digit: a whole one of 53 bits, times or over an exact power of ten.
    """
    at, size, row, width = 0, text.size, 0, places.size
    while at < size:
        for column in range(width):
            negative = text[at] == 45
            if negative or text[at] == 43:
                at += 1
            whole, digits, seen, behind, power = 0, 0, 0, 0, 0
            fraction = False
            while at < size:
                sign = text[at]
                if 48 <= sign <= 57:
                    seen += 1
                    digits += 1 if digits or sign != 48 else 0
                    behind += 1 if fraction else 0
                    if digits <= MOST_DIGITS:
                        whole = 10 * whole + (int(sign) - 48)
                elif sign == decimal and not fraction:
                    fraction = True
                else:
                    break
                at += 1
            if not seen:
                return -1
            if at < size and (text[at] == 101 or text[at] == 69):
                at += 1
                down = at < size and text[at] == 45
                if at < size and (down or text[at] == 43):
                    at += 1
                begin = at
                while at < size and 48 <= text[at] <= 57 and at - begin < 6:
                    power = 10 * power + (int(text[at]) - 48)
                    at += 1
                if at == begin:
                    return -1
                power = -power if down else power
            end = 10 if column == width - 1 else separator
            if (at < size and text[at] != end) or (at == size and column < width - 1):
                return -1
            at += 1
            if at == size and column < width - 1:
                return -1
            if places[column] < 0:
                continue
            power -= behind
            if whole and (digits > MOST_DIGITS or whole > LARGEST_WHOLE or power > 22 or power < -22):
                return -1
            value = float(whole)
            if whole:
                value = value * POWERS[power] if power >= 0 else value / POWERS[-power]
            out[places[column], row] = -value if negative else value
        row += 1
    return row
