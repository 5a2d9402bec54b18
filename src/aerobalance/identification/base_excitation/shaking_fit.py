"""Maximum likelihood of A, D and the mass in the records of a shaken balance, with noise in loads and ground motion.

Without noise F = 0 makes X + D X' + A X'' + M x1'' = 0 at every frequency. What the readings leave of it, seen as
loads, is r = G (X + D X' + A X'' + M x1''), G = (1 + D s + A s^2)^-1. With the noise R of the loads and N of the
ground motion its covariance is S = R + G M N (G M)*, and minus twice the logarithm of the likelihood, in which the
ground motion at every frequency has been eliminated, is the sum of r* S^-1 r. Its slope holds the most likely loads
and ground motion in place of the readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.inertial_parameters import NUMBERS, mass_basis
from aerobalance.identification.base_excitation.shaking_record import ShakeRecord
from aerobalance.identification.levenberg_marquardt import Settings, Step, levenberg_marquardt
from aerobalance.identification.step_relaxation.free_response import Complex
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

MATRICES: Final = 72
"""Elements of A and D."""

DELAY: Final = MATRICES + NUMBERS
"""Place of the delay among the parameters; what is not known of the sensors comes after it."""

CHUNK: Final = 2048
"""Frequencies that are worked on at once."""

SETTINGS: Final = Settings(
    most_steps=40,
    enough=1e-3,
    enough_of_cost=1e-10,
    barely=0.1,  # far below what the covariance could tell
    raised=1e-4,
)
"""How the fit is damped, and when it has settled."""

MOST_LIKELY: Final = 2.0
"""Most likely motion over that read beyond which it is noise that was read."""

UNTOLD: Final = 1e-7
"""Singular value of the rows, columns of one size, over the largest, below which it is rounding of their products."""

ENOUGH_AT_FIRST: Final = 800
"""Frequencies of all records together that a first guess is made from."""

ROUNDS: Final = 5
"""Times that the first guess is weighted with the response of the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """Parameters that are tried or found.

    Attributes
    ----------
    values
        A and D row by row [s^2, s], the ten numbers of the mass, the delay of the loads [s], and what is not known
        of the sensors in standard uncertainties; shape (83 + q,).
    noise
        Covariance of the noise of the loads, shape (6, 6).
    unknowns
        Names of the q last parameters.
    """

    values: Array
    noise: Array
    unknowns: tuple[tuple[str, str], ...]

    @property
    def inertia(self) -> Array:
        """A [s^2]."""
        return self.values[:36].reshape(6, 6)

    @property
    def damping(self) -> Array:
        """D [s]."""
        return self.values[36:MATRICES].reshape(6, 6)

    @property
    def numbers(self) -> Array:
        """Ten numbers of the mass."""
        return self.values[MATRICES:DELAY]

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix, shape (6, 6)."""
        return np.tensordot(self.numbers, mass_basis(), axes=1)

    def response(self, frequency: Array) -> Complex:
        """G, loads felt over loads applied, shape (m, 6, 6)."""
        s = 2j * np.pi * frequency[:, None, None]
        return np.linalg.inv(np.eye(6) + s * self.damping + s**2 * self.inertia)

    def at(self, values: Array) -> Shaken:
        """Other values."""
        return replace(self, values=values)


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """A record near some parameters, at m frequencies.

    Attributes
    ----------
    left
        What is left of the loads, S^-1/2 r, shape (m, 6).
    load_noise
        Most likely noise of the loads, shape (m, 6).
    spread
        Covariance of what is not known of it, shape (m, 6, 6).
    weight
        S^-1/2 G: what turns an equation into weighted rows, shape (m, 6, 6).
    rates, seconds, motion, taken
        Most likely derivatives of the loads, ground motion and loads that it takes.
    read
        The ground motion with its noise.
    """

    left: Complex
    load_noise: Complex
    spread: Complex
    weight: Complex
    rates: Complex
    seconds: Complex
    motion: Complex
    taken: Complex
    read: Complex


def near(record: ShakeRecord, tried: Shaken) -> Near:
    """What is left of a record, and what is most likely behind it."""
    s = 2j * np.pi * record.frequency[:, None]
    turn = np.exp(s * tried.values[DELAY])
    loads, rates, seconds = record.loads * turn, record.rates * turn, record.seconds * turn
    mass, response = tried.mass_matrix, tried.response(record.frequency)
    moved = np.zeros_like(record.motion)
    for key, change in zip(tried.unknowns, tried.values[DELAY + 1 :], strict=True):
        if key in record.slopes:
            moved = moved + change * record.unknown[key] * record.slopes[key]
    taken = record.taken + np.einsum("kij,mj->mik", mass_basis(), moved)
    equation = loads + rates @ tried.damping.T + seconds @ tried.inertia.T + taken @ tried.numbers
    rest = np.einsum("mij,mj->mi", response, equation)
    through = response @ mass
    grown = _growth(record.motion, moved)
    brought = record.motion_noise * np.outer(grown, grown) @ np.conj(np.swapaxes(through, 1, 2))
    whole = tried.noise + through @ brought
    factor = np.linalg.inv(np.linalg.cholesky(whole))
    left = np.einsum("mij,mj->mi", factor, rest)
    weighted = np.einsum("mji,mj->mi", np.conj(factor), left)  # S^-1 r
    noise = weighted @ tried.noise
    motion = np.einsum("mij,mj->mi", brought, weighted)
    return Near(
        left=left,
        load_noise=noise,
        spread=tried.noise - tried.noise @ (np.conj(np.swapaxes(factor, 1, 2)) @ factor) @ tried.noise,
        weight=factor @ response,
        rates=rates - s * noise,
        seconds=seconds - s**2 * noise,
        read=record.motion + moved,
        motion=record.motion + moved - motion,
        taken=taken - np.einsum("kij,mj->mik", mass_basis(), motion),
    )


def _growth(motion: Complex, moved: Complex) -> Array:
    """Size of the motion as corrected over that as read, shape (6,): a gain is one of the noise too."""
    before, after = (np.sum(np.abs(part) ** 2, axis=0) for part in (motion, motion + moved))
    return np.asarray(np.sqrt(np.divide(after, before, out=np.ones(6), where=before > 0)))


def columns(record: ShakeRecord, here: Near, tried: Shaken) -> Complex:
    """Derivatives of what is left by the parameters, shape (m, 6, 83 + q)."""
    count = record.frequency.size
    found = np.zeros((count, 6, tried.values.size), dtype=np.complex128)
    for place, motion in ((0, here.seconds), (36, here.rates)):
        product = here.weight[:, :, :, None] * motion[:, None, None, :]
        found[:, :, place : place + 36] = product.reshape(count, 6, 36)
    found[:, :, MATRICES:DELAY] = here.weight @ here.taken
    # a delay moves the loads by their rates, and what is left with them
    found[:, :, DELAY] = np.einsum(
        "mij,mj->mi", here.weight @ np.linalg.inv(tried.response(record.frequency)), here.rates
    )
    likely = np.divide(here.motion, here.read, out=np.ones_like(here.read), where=np.abs(here.read) > 0)
    likely[np.abs(likely) > MOST_LIKELY] = 1.0
    for number, key in enumerate(tried.unknowns):
        if key in record.slopes:  # which hold the noise of the motion, as a gain does
            change = record.unknown[key] * (likely * record.slopes[key]) @ tried.mass_matrix.T
            found[:, :, DELAY + 1 + number] = np.einsum("mij,mj->mi", here.weight, change)
    return found


def rows_of(table: Complex, left: Complex, share: float) -> Array:
    """Real rows of unit noise (12 m, k + 1) from complex columns (m, 6, k), and minus what is left as the last."""
    flat = np.concatenate([table, -left[:, :, None]], axis=2).reshape(-1, table.shape[2] + 1)
    return np.asarray(np.sqrt(2 * share) * np.vstack([flat.real, flat.imag]))


def products_of(table: Complex, left: Complex, share: float) -> Array:
    """Products of the columns of these rows, (k + 1, k + 1): fast, with half the digits of triangular rows."""
    rows = rows_of(table, left, share)
    return rows.T @ rows


def chunks(record: ShakeRecord) -> Iterator[ShakeRecord]:
    """The record in parts of frequencies that are small enough to be worked on at once."""
    for first in range(0, record.frequency.size, CHUNK):
        yield record.keep(slice(first, first + CHUNK))


def reduced(table: Array) -> Array:
    """Triangular rows with the same squares as those of a table."""
    return np.asarray(np.linalg.qr(table, mode="r"), dtype=np.float64)


def rows_with(products: Array) -> Array:
    """Square rows that have these products, with every column brought to one size on the way."""
    size = np.sqrt(np.diag(products))
    told = size > 0
    size[~told] = 1.0
    values, directions = np.linalg.eigh(products / np.outer(size, size))
    return reduced(np.sqrt(np.maximum(values, 0.0))[:, None] * directions.T * np.where(told, size, 0.0))


def information_rows(records: Sequence[ShakeRecord], tried: Shaken) -> Array:
    """Square rows of the derivatives, with minus what is left as the last column, of all records and knowledge."""
    known = known_rows(tried)
    products = known.T @ known
    for record in records:
        for part in chunks(record):
            here = near(part, tried)
            products += products_of(columns(part, here, tried), here.left, record.share)
    return rows_with(products)


def known_rows(tried: Shaken) -> Array:
    """Rows for what is known of the sensors: every unknown is zero with a standard uncertainty of one."""
    q = tried.values.size
    rows = np.zeros((len(tried.unknowns), q + 1))
    rows[:, DELAY + 1 : q] = np.eye(len(tried.unknowns))
    rows[:, q] = -tried.values[DELAY + 1 :]
    return rows


def squares_of(records: Sequence[ShakeRecord], tried: Shaken) -> float:
    """Sum of the weighted squares, about 12 for every frequency and share."""
    total = float(np.sum(tried.values[DELAY + 1 :] ** 2))
    for record in records:
        for part in chunks(record):
            total += 2 * record.share * float(np.sum(np.abs(near(part, tried).left) ** 2))
    return total


def least_squares(rows: Array, damping: float = 0.0) -> Array:
    """Solution of triangular rows, its columns brought to one size; what they do not tell stays at zero."""
    table, target = rows[:, :-1], rows[:, -1]
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0] = 1.0
    full = np.vstack([table / scale, damping * np.eye(scale.size)])
    aim = np.concatenate([target, np.zeros(scale.size)])
    return np.asarray(np.linalg.lstsq(full, aim, rcond=UNTOLD)[0] / scale)


def first_guess(records: Sequence[ShakeRecord], *, sizes: Array) -> Shaken:
    """Parameters from the equation itself, which is linear in them, weighted anew with the response just found."""
    noise = np.diag(np.min([record.noise for record in records], axis=0) ** 2)
    unknowns = tuple(dict.fromkeys(key for record in records for key in record.slopes))
    found = Shaken(np.zeros(DELAY + 1 + len(unknowns)), noise, unknowns)
    step = max(sum(record.frequency.size for record in records) // ENOUGH_AT_FIRST, 1)
    records = [record.keep(slice(None, None, step)) for record in records]
    middle = float(np.exp(np.mean([np.mean(np.log(record.frequency)) for record in records])))
    for turn in range(ROUNDS):
        products = np.zeros((DELAY + 1, DELAY + 1))
        for record in records:
            for part in chunks(record):
                if turn:
                    weight = near(part, found).weight
                else:  # noise grows with the square of the frequency in the equation
                    falls = 1 / (1 + (part.frequency / middle) ** 2)
                    weight = (falls[:, None, None] * np.diag(1 / sizes)).astype(np.complex128)
                products += _plain_products(part, weight)
        values = found.values.copy()
        values[:DELAY] = least_squares(rows_with(products))
        found = found.at(values)
    return found


def _plain_products(record: ShakeRecord, weight: Complex) -> Array:
    """Products of the rows of the equation with the readings as they are."""
    moved = [
        (weight[:, :, :, None] * part[:, None, None, :]).reshape(-1, 6, 36) for part in (record.seconds, record.rates)
    ]
    table = np.concatenate([*moved, weight @ record.taken], axis=2)
    return products_of(table, np.einsum("mij,mj->mi", weight, record.loads), 1.0)


def settle(records: Sequence[ShakeRecord], start: Shaken) -> Shaken:
    """Return the most likely parameters, by the Levenberg-Marquardt method.

    Raises
    ------
    FitError
        The fit does not settle.
    """

    def step(here: Shaken, damping: float) -> Step[Shaken]:
        rows = information_rows(records, here)
        move = least_squares(rows, damping)
        promised = float(rows[:, -1] @ rows[:, -1] - np.sum((rows[:, -1] - rows[:, :-1] @ move) ** 2))
        trial = here.at(here.values + move)
        return Step(promised, lambda: (trial, squares_of(records, trial)))

    found = levenberg_marquardt(start, squares_of(records, start), step, SETTINGS)
    if found.settled:
        return found.state
    raise FitError(
        f"{', '.join(record.name for record in records)}: the fit of the shaken records does not settle; are all of "
        "one and the same balance and model, with no wind and nothing touching it?"
    )


def with_noise(records: Sequence[ShakeRecord], fit: Shaken, *, least: Array) -> Shaken:
    """The same with the noise of the loads that the residuals show: one step of expectation and maximisation.

    Parameters
    ----------
    records, fit
        What was fitted.
    least
        Standard deviations that the noise has at least, shape (6,).
    """
    total, count = np.zeros((6, 6)), 0
    for record in records:
        for part in chunks(record):
            here = near(part, fit)
            total += np.real(here.load_noise.T @ np.conj(here.load_noise) + here.spread.sum(axis=0))
            count += part.frequency.size
    covariance = total / max(count - fit.values.size / 12, 1)
    deviation = np.maximum(np.sqrt(np.diag(covariance)), least)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    if (deviation <= least).any() or np.linalg.eigvalsh(correlation)[0] < 1e-3:
        correlation = np.eye(6)  # not noise but rounding, or a misfit that all components share
    return replace(fit, noise=np.asarray(correlation * np.outer(deviation, deviation)))
