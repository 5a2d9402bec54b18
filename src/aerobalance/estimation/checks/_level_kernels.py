"""Compiled loops for the likeliest levels of forces, by their spectral lines: nothing is checked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.estimation.checks._root_kernels import add_to_root, over, whiten
from aerobalance.estimation.spectra._kernels import Search, solve_by_root
from aerobalance.recording.compiled import compiled

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class ForceLines(NamedTuple):
    """Spectral lines of n forces at m ordinates, and how noise of the channels comes into them.

    Attributes
    ----------
    lines
        The lines, shape (n, m).
    rows
        What each force takes of every channel at the ordinates, shape (m, n, n).
    noise
        Density of each channel's noise, shape (n,).
    gain
        Density of a line over that of its force, shape (n, m).
    told
        Which ordinates count, shape (m,).
    share
        Share of a line's density that is noise, from which on its correlation with others counts.
    """

    lines: Complexes
    rows: Complexes
    noise: Floats
    gain: Floats
    told: Flags
    share: float


class Scoring(NamedTuple):
    """Room for what scoring the levels of n forces needs.

    Attributes
    ----------
    slope, ratio
        Slopes of a log-likelihood by the levels, and the factors that expectation and maximization give, shape (n,).
    information
        Lower half of the information that is expected, shape (n, n).
    density
        Densities of the lines at an ordinate, shape (n,).
    noisy
        Lines at an ordinate whose noise counts, shape (n,).
    white
        These lines, whitened by the root of their covariance, shape (n,).
    root, inverse
        That root and its inverse, lower halves of shape (n, n).
    """

    slope: Floats
    ratio: Floats
    information: Floats
    density: Floats
    noisy: Integers
    white: Complexes
    root: Complexes
    inverse: Complexes


@compiled(inner=True, fastmath={"contract"})
def begin_band(forces: ForceLines, first: int, last: int, level: Floats, common: Complexes) -> int:
    """Return how many ordinates of a band count, and write what the search for its levels begins with.

    Parameters
    ----------
    forces
        The lines.
    first, last
        The ordinates are those from the first up to the last, without that.
    level
        Takes all that the band has as density of each force, its first n of shape (n,) or (2 n,).
    common
        Takes the lower half of the covariance of the noise in the lines, shape (last - first, n, n).
    """
    count, told = forces.lines.shape[0], 0
    for i in range(count):
        level[i] = 0.0
    for place in range(first, last):
        if not forces.told[place]:
            continue
        told += 1
        for i in range(count):
            line = forces.lines[i, place]
            level[i] += (line.real**2 + line.imag**2) / forces.gain[i, place]
            for j in range(i + 1):
                both = 0j
                for k in range(count):
                    both += forces.rows[place, i, k] * forces.noise[k] * np.conj(forces.rows[place, j, k])
                common[place - first, i, j] = both
    for i in range(count):
        level[i] /= max(told, 1)
    return told


@compiled(inner=True, fastmath={"contract"})
def score_levels(level: Floats, forces: ForceLines, first: int, last: int, common: Complexes, room: Scoring) -> float:
    """Return the log-likelihood of lines at some ordinates, and write what scoring needs.

    Parameters
    ----------
    level
        Density of each force, shape (n,).
    forces
        The lines.
    first, last
        The ordinates are those from the first up to the last, without that.
    common
        Lower half of the covariance of the noise in the lines at these, shape (last - first, n, n).
    room
        What is written.
    """
    count = level.size
    slope, ratio, information, density = room.slope, room.ratio, room.information, room.density
    noisy, white, root, inverse = room.noisy, room.white, room.root, room.inverse
    found = 0.0
    for i in range(count):
        slope[i] = ratio[i] = 0.0
        for j in range(count):
            information[i, j] = 0.0
    for place in range(first, last):
        if not forces.told[place]:
            continue
        size = 0
        for i in range(count):
            own, line, gain = common[place - first, i, i].real, forces.lines[i, place], forces.gain[i, place]
            density[i] = level[i] * gain + own
            if own > forces.share * density[i]:
                noisy[size] = i
                size += 1
                continue
            power, gain = (line.real**2 + line.imag**2) / density[i], gain / density[i]
            found -= np.log(density[i]) + power
            slope[i] += gain * power
            ratio[i] += gain
            information[i, i] += gain * gain
        for a in range(size):  # the root of the covariance of all whose noise counts
            for b in range(a + 1):
                left = common[place - first, noisy[a], noisy[b]] if b < a else complex(density[noisy[a]])
                found = add_to_root(left, a, b, 1e-12, root, found)
            found = whiten(forces.lines[noisy[a], place], a, root, white, found)
            inverse[a, a] = 1 / root[a, a].real
            for b in range(a):
                left = 0j
                for c in range(b, a):
                    left -= root[a, c] * inverse[c, b]
                inverse[a, b] = left * inverse[a, a].real
        for b in range(size):
            i = noisy[b]
            gain, line = forces.gain[i, place], 0j
            for a in range(b, size):
                line += np.conj(inverse[a, b]) * white[a]
            slope[i] += gain * (line.real**2 + line.imag**2)
            for c in range(b + 1):
                left = 0j
                for a in range(b, size):
                    left += np.conj(inverse[a, b]) * inverse[a, c]
                j = noisy[c]
                information[i, j] += gain * forces.gain[j, place] * (left.real**2 + left.imag**2)
                if b == c:
                    ratio[i] += gain * left.real
    for i in range(count):
        up, down = slope[i], ratio[i]
        slope[i], ratio[i] = up - down, up / down if down > 0 else 1.0
    return found


@compiled(inner=True)
def move_levels(
    level: Floats, slope: Floats, information: Floats, free: Integers, table: Floats, step: Floats
) -> None:
    """Move levels by a step of scoring; those that it would make negative become zero, and the others go on.

    Parameters
    ----------
    level
        The levels, which are moved, shape (n,).
    slope, information
        As `score_levels` writes them, shapes (n,) and (n, n).
    free, table, step
        Room, shapes (n,), (n, n) and (n,).
    """
    size = 0
    for i in range(level.size):
        if level[i] > 0 or slope[i] > 0:
            free[size] = i
            size += 1
    while size:
        for a in range(size):
            step[a] = slope[free[a]]
            for b in range(a + 1):
                table[a, b] = information[free[a], free[b]]
            table[a, a] *= 1.0 + 1e-9
        solve_by_root(table, size, step)
        left_over = 0
        for a in range(size):
            if level[free[a]] + step[a] <= 0:
                level[free[a]] = 0.0
            else:
                free[left_over], step[left_over] = free[a], step[a]
                left_over += 1
        if left_over == size:
            for a in range(size):
                level[free[a]] += step[a]
            return
        size = left_over


@compiled(nogil=True, error_model="numpy")
def likeliest_levels(forces: ForceLines, bands: Integers, steps: int, enough: float, found: Floats) -> None:
    """Write the log-likelihood of lines in every band, the densities of all forces there at their likeliest.

    Scoring begins with all that a band has, noise as well: a level that begins at nothing hardly comes up from there.
    Where a step of it makes the lines less likely, one of expectation and maximization is taken.

    Parameters
    ----------
    forces
        The lines.
    bands
        First ordinate of every band, shape (b,).
    steps
        Steps at most.
    enough
        Gain in log-likelihood of a step from which on no more are taken.
    found
        The log-likelihoods, shape (b,).
    """
    count, ordinates = forces.lines.shape
    room = Scoring(
        np.empty(count),
        np.empty(count),
        np.empty((count, count)),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(count, np.complex128),
        np.empty((count, count), np.complex128),
        np.empty((count, count), np.complex128),
    )
    level, best, ratio = np.empty(count), np.empty(count), np.empty(count)
    free, table, step = np.empty(count, np.int64), np.empty((count, count)), np.empty(count)
    for band in range(bands.size):
        first, last = bands[band], bands[band + 1] if band + 1 < bands.size else ordinates
        common = np.empty((last - first, count, count), np.complex128)
        found[band] = 0.0
        if not begin_band(forces, first, last, level, common):
            continue
        most = -np.inf
        for taken in range(steps):
            now = score_levels(level, forces, first, last, common, room)
            if taken and not now > most:
                for i in range(count):
                    level[i] = best[i] * ratio[i]
                    ratio[i] = np.sqrt(ratio[i])
                continue
            gained = now - most
            most = now
            for i in range(count):
                best[i], ratio[i] = level[i], room.ratio[i]
            if gained < enough:
                break
            if taken:
                move_levels(level, room.slope, room.information, free, table, step)
            else:
                for i in range(count):
                    level[i] *= ratio[i]
        found[band] = most


class JointScoring(NamedTuple):
    """Room for what scoring the levels of n forces and of the noise of as many channels together needs.

    Attributes
    ----------
    slope
        Slopes of a log-likelihood by the levels, shape (2 n,).
    information
        Lower half of the information that is expected, shape (2 n, 2 n).
    white
        Lines at an ordinate, whitened by the root of their covariance, shape (n,).
    root
        That root, the lower half, shape (n, n).
    parts
        What each level is a density of, whitened by it, shape (2 n, n).
    """

    slope: Floats
    information: Floats
    white: Complexes
    root: Complexes
    parts: Complexes


@compiled(inner=True, fastmath={"contract"})
def score_levels_and_noise(
    level: Floats, forces: ForceLines, first: int, last: int, common: Complexes, room: JointScoring
) -> float:
    """Return the log-likelihood of lines at some ordinates, and write what scoring needs.

    Parameters
    ----------
    level
        Density of each force, then what each channel's noise has beside that which is known, shape (2 n,).
    forces, first, last, common
        As of `score_levels`.
    room
        What is written.
    """
    count = forces.lines.shape[0]
    slope, information, white, root, parts = room.slope, room.information, room.white, room.root, room.parts
    found = 0.0
    slope[:] = 0.0
    information[:] = 0.0
    for place in range(first, last):
        if not forces.told[place]:
            continue
        rows = forces.rows[place]
        for a in range(count):
            for b in range(a + 1):
                left = common[place - first, a, b]
                for k in range(count):
                    left += rows[a, k] * level[count + k] * np.conj(rows[b, k])
                if a == b:
                    left += level[a] * forces.gain[a, place]
                found = add_to_root(left, a, b, 1e-12, root, found)
            found = whiten(forces.lines[a, place], a, root, white, found)
        for i in range(2 * count):
            begin = i if i < count else 0  # a force is in its own line and, whitened, in those after it
            line = 0j
            for a in range(begin, count):
                left = complex(np.sqrt(forces.gain[i, place])) if a == i else 0j
                if i >= count:
                    left = rows[a, i - count]
                for c in range(begin, a):
                    left -= root[a, c] * parts[i, c]
                parts[i, a] = over(left, root[a, a].real)
                line += np.conj(parts[i, a]) * white[a]
            slope[i] += line.real**2 + line.imag**2
            for j in range(i + 1):
                both = 0j
                for a in range(max(begin, j if j < count else 0), count):
                    both += np.conj(parts[i, a]) * parts[j, a]
                information[i, j] += both.real**2 + both.imag**2
                if i == j:
                    slope[i] -= both.real
    return found


@compiled(nogil=True, error_model="numpy")
def likeliest_levels_and_noise(
    forces: ForceLines, power: Floats, bands: Integers, search: Search, found: Floats
) -> None:
    """Write the log-likelihood of lines in every band, the densities of forces and noise there at their likeliest.

    The logarithms of the levels are moved by damped scoring, which begins with all that a band has as force and as
    noise.

    Parameters
    ----------
    forces
        The lines; their share does not matter, and their noise is what there is of it at least.
    power
        Density of each channel, shape (n, m).
    bands
        First ordinate of every band, shape (b,).
    search
        How the search goes on; its ends do not matter.
    found
        The log-likelihoods, shape (b,).
    """
    count, ordinates = forces.lines.shape
    size = 2 * count
    room = JointScoring(
        np.empty(size),
        np.empty((size, size)),
        np.empty(count, np.complex128),
        np.empty((count, count), np.complex128),
        np.empty((size, count), np.complex128),
    )
    level, best, slope, information = np.empty(size), np.empty(size), np.empty(size), np.empty((size, size))
    table, step = np.empty((size, size)), np.empty(size)
    for band in range(bands.size):
        first, last = bands[band], bands[band + 1] if band + 1 < bands.size else ordinates
        common = np.empty((last - first, count, count), np.complex128)
        found[band] = 0.0
        told = begin_band(forces, first, last, level, common)
        if not told:
            continue
        for i in range(count):
            level[count + i] = 0.0
            for place in range(first, last):
                if forces.told[place]:
                    level[count + i] += power[i, place] / told
        most, damping, still = -np.inf, search.damping, 0
        for _ in range(search.steps):
            now = score_levels_and_noise(level, forces, first, last, common, room)
            if now > most:
                still = 0 if now - most > search.enough else still + 1
                most, damping = now, damping / 10
                best[:] = level
                for i in range(size):
                    slope[i] = room.slope[i] * best[i]
                    for j in range(i + 1):
                        information[i, j] = room.information[i, j] * best[i] * best[j]
                if still == 2:
                    break
            else:
                damping *= 10
            for i in range(size):
                step[i] = slope[i]
                for j in range(i + 1):
                    table[i, j] = information[i, j]
                table[i, i] += damping * table[i, i] + 1e-6
            solve_by_root(table, size, step)
            for i in range(size):
                level[i] = best[i] * np.exp(min(max(step[i], -search.longest), search.longest))
        found[band] = most
