"""Maximum likelihood of A, D and the mass in the records of a shaken balance, with noise in loads and ground motion.

Without noise, F = 0 makes X + D X' + A X'' + M x1'' = 0 at every frequency. With noise the readings leave a residual,
written as balance loads r = G (X + D X' + A X'' + M x1''), where G = (1 + D s + A s^2)^-1. If R is the covariance of
the noise of the loads and N that of the ground motion, the covariance of r is S = R + G M N (G M)*. The true ground
motion at every frequency is eliminated, and minus twice the logarithm of the likelihood is the sum of r* S^-1 r over
the frequencies. Its gradient holds the most likely loads and ground motion (their expectations given the readings) in
place of the readings.

The fit solves linear systems by rows: a table of k columns and, as column k + 1, the right-hand side, which is minus
the residual. Rows have unit noise, so that their products are the Fisher information.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.rigid_body import NUMBERS, inertial_loads, mass_basis
from aerobalance.identification.base_excitation.shaking_record import ShakeRecord
from aerobalance.identification.coupled.free_response import Complex
from aerobalance.identification.levenberg_marquardt import DampedStep, Settings, levenberg_marquardt
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError

MATRICES: Final = 72
"""Number of elements of A and D together."""

DELAY: Final = MATRICES + NUMBERS
"""Place of the delay among the parameters; the systematic parameters of the sensors come after it."""

CHUNK: Final = 2048
"""Frequencies computed at once: more would take more memory."""

SETTINGS: Final = Settings(
    most_steps=40,
    enough=1e-3,
    enough_of_cost=1e-10,
    barely=0.1,  # far below what the covariance could tell
    raised=1e-4,
)
"""How the fit is damped, and when it has settled."""

MOST_LIKELY: Final = 2.0
"""Most likely ground motion over that read [1], above which the reading was noise."""

ROUNDING: Final = 1e-7
"""Singular value over the largest [1], of rows with columns of unit size, below which it is taken for rounding: the
products that the rows are made from keep half of the digits."""

ENOUGH_AT_FIRST: Final = 800
"""Number of frequencies, of all records together, that the first guess uses at least."""

ROUNDS: Final = 5
"""Rounds of the first guess; each takes its weights from the response found in the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class ShakeParameters:
    """Parameters of the likelihood, on trial or found.

    Attributes
    ----------
    values
        A and D row by row [s^2, s], the ten numbers of the mass (`NUMBERS`), the delay of the loads [s], and q
        systematic parameters of the sensors, each over its standard uncertainty [1]; shape (83 + q,).
    noise
        Covariance R of the noise of the loads, shape (6, 6) [N, N*m, squared].
    unknowns
        Names of the q last parameters, name and source.
    """

    values: Array
    noise: Array
    unknowns: tuple[tuple[str, str], ...]

    @property
    def inertia(self) -> Array:
        """A, shape (6, 6) [s^2]."""
        return self.values[:36].reshape(6, 6)

    @property
    def damping(self) -> Array:
        """D, shape (6, 6) [s]."""
        return self.values[36:MATRICES].reshape(6, 6)

    @property
    def numbers(self) -> Array:
        """The ten numbers of a rigid mass, as in `NUMBERS`, shape (10,)."""
        return self.values[MATRICES:DELAY]

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix M, shape (6, 6) [kg, kg*m, kg*m^2]."""
        return np.tensordot(self.numbers, mass_basis(), axes=1)

    def response(self, frequency: Array) -> Complex:
        """Transfer matrix G from forces to balance loads at frequencies [Hz] of shape (m,), shape (m, 6, 6)."""
        s = 2j * np.pi * frequency[:, None, None]
        return np.linalg.inv(np.eye(6) + s * self.damping + s**2 * self.inertia)

    def at(self, values: Array) -> ShakeParameters:
        """Return the same with other values, shape (83 + q,)."""
        return replace(self, values=values)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A record at given parameters, at m frequencies: weighted residual, and expectations given the readings.

    Attributes
    ----------
    residual
        Weighted residual S^-1/2 r, shape (m, 6) [1].
    load_noise
        Expectation of the noise of the loads, shape (m, 6) [N, N*m].
    spread
        Covariance of that noise given the readings, shape (m, 6, 6).
    weight
        S^-1/2 G, which makes weighted rows of the equation, shape (m, 6, 6).
    rates, seconds, motion, taken
        Expectations of the first and second derivative of the loads, of the ground motion, shape (m, 6) each, and of
        the loads that it takes for a unit of each number of the mass, shape (m, 6, 10).
    read
        The ground motion as read, corrected by the systematic parameters, with its noise, shape (m, 6).
    """

    residual: Complex
    load_noise: Complex
    spread: Complex
    weight: Complex
    rates: Complex
    seconds: Complex
    motion: Complex
    taken: Complex
    read: Complex


def evaluate(record: ShakeRecord, parameters: ShakeParameters) -> Evaluation:
    """Return the weighted residual of a record at given parameters, and the most likely signals without noise."""
    s = 2j * np.pi * record.frequency[:, None]
    advance = np.exp(s * parameters.values[DELAY])  # undoes the delay of the loads
    loads, rates, seconds = record.loads * advance, record.rates * advance, record.seconds * advance
    mass, response = parameters.mass_matrix, parameters.response(record.frequency)
    correction = np.zeros_like(record.motion)
    for key, change in zip(parameters.unknowns, parameters.values[DELAY + 1 :], strict=True):
        if key in record.slopes:
            correction = correction + change * record.unknown[key] * record.slopes[key]
    taken = record.taken + inertial_loads(correction)
    equation = loads + rates @ parameters.damping.T + seconds @ parameters.inertia.T + taken @ parameters.numbers
    unweighted = np.einsum("mij,mj->mi", response, equation)  # r
    through = response @ mass  # G M
    grown = _growth(record.motion, correction)
    crossed = record.motion_noise * np.outer(grown, grown) @ np.conj(np.swapaxes(through, 1, 2))  # N (G M)*
    covariance = parameters.noise + through @ crossed  # S
    factor = np.linalg.inv(np.linalg.cholesky(covariance))  # S^-1/2
    residual = np.einsum("mij,mj->mi", factor, unweighted)
    weighted = np.einsum("mji,mj->mi", np.conj(factor), residual)  # S^-1 r
    load_noise = weighted @ parameters.noise
    motion_noise = np.einsum("mij,mj->mi", crossed, weighted)
    spread = parameters.noise - parameters.noise @ (np.conj(np.swapaxes(factor, 1, 2)) @ factor) @ parameters.noise
    return Evaluation(
        residual=residual,
        load_noise=load_noise,
        spread=spread,
        weight=factor @ response,
        rates=rates - s * load_noise,
        seconds=seconds - s**2 * load_noise,
        read=record.motion + correction,
        motion=record.motion + correction - motion_noise,
        taken=taken - inertial_loads(motion_noise),
    )


def _growth(motion: Complex, correction: Complex) -> Array:
    """Rms of the motion as corrected over that as read, shape (6,) [1]: a gain applies to the noise too."""
    before, after = (np.sum(np.abs(part) ** 2, axis=0) for part in (motion, motion + correction))
    return np.asarray(np.sqrt(np.divide(after, before, out=np.ones(6), where=before > 0)))


def jacobian(record: ShakeRecord, here: Evaluation, parameters: ShakeParameters) -> Complex:
    """Return the derivatives of the weighted residual by the parameters, shape (m, 6, 83 + q)."""
    count = record.frequency.size
    found = np.zeros((count, 6, parameters.values.size), dtype=np.complex128)
    for place, motion in ((0, here.seconds), (36, here.rates)):
        product = here.weight[:, :, :, None] * motion[:, None, None, :]
        found[:, :, place : place + 36] = product.reshape(count, 6, 36)
    found[:, :, MATRICES:DELAY] = here.weight @ here.taken
    # a delay changes the loads by their rates, and the residual r by as much
    found[:, :, DELAY] = np.einsum(
        "mij,mj->mi", here.weight @ np.linalg.inv(parameters.response(record.frequency)), here.rates
    )
    likely = np.divide(here.motion, here.read, out=np.ones_like(here.read), where=np.abs(here.read) > 0)
    likely[np.abs(likely) > MOST_LIKELY] = 1.0
    for number, key in enumerate(parameters.unknowns):
        if key in record.slopes:
            # the slope of a gain is the motion as read, with its noise: scaled down to the most likely motion
            change = record.unknown[key] * (likely * record.slopes[key]) @ parameters.mass_matrix.T
            found[:, :, DELAY + 1 + number] = np.einsum("mij,mj->mi", here.weight, change)
    return found


def rows_of(table: Complex, residual: Complex, share: float) -> Array:
    """Return real rows of unit noise, shape (12 m, k + 1), from complex columns, shape (m, 6, k), and a residual.

    `residual` has shape (m, 6); `share` is what the window leaves of the information [1].
    """
    flat = np.concatenate([table, -residual[:, :, None]], axis=2).reshape(-1, table.shape[2] + 1)
    return np.asarray(np.sqrt(2 * share) * np.vstack([flat.real, flat.imag]))


def products_of(table: Complex, residual: Complex, share: float) -> Array:
    """Return the products of the columns of `rows_of`, shape (k + 1, k + 1).

    They are computed faster than triangular rows (`reduced`), but keep half of their digits only.
    """
    rows = rows_of(table, residual, share)
    return rows.T @ rows


def chunks(record: ShakeRecord) -> Iterator[ShakeRecord]:
    """Yield the record in parts of at most `CHUNK` frequencies."""
    for first in range(0, record.frequency.size, CHUNK):
        yield record.keep(slice(first, first + CHUNK))


def reduced(table: Array) -> Array:
    """Return triangular rows with the same products as the rows of a table: the R of its QR decomposition."""
    return np.asarray(np.linalg.qr(table, mode="r"), dtype=np.float64)


def rows_from_products(products: Array) -> Array:
    """Return triangular rows that have these products, shape (k + 1, k + 1).

    Columns are scaled to unit size meanwhile, as their units differ by many orders.
    """
    size = np.sqrt(np.diag(products))
    known = size > 0
    size[~known] = 1.0
    values, directions = np.linalg.eigh(products / np.outer(size, size))
    return reduced(np.sqrt(np.maximum(values, 0.0))[:, None] * directions.T * np.where(known, size, 0.0))


def information_rows(records: Sequence[ShakeRecord], parameters: ShakeParameters) -> Array:
    """Return triangular rows of all records and of the knowledge of the sensors, shape (84 + q, 84 + q)."""
    known = known_rows(parameters)
    products = known.T @ known
    for record in records:
        for part in chunks(record):
            here = evaluate(part, parameters)
            products += products_of(jacobian(part, here, parameters), here.residual, record.share)
    return rows_from_products(products)


def known_rows(parameters: ShakeParameters) -> Array:
    """Return rows for the knowledge of the sensors, shape (q, 84 + q): their parameters are 0 to within 1."""
    count = parameters.values.size
    rows = np.zeros((len(parameters.unknowns), count + 1))
    rows[:, DELAY + 1 : count] = np.eye(len(parameters.unknowns))
    rows[:, count] = -parameters.values[DELAY + 1 :]
    return rows


def squares_of(records: Sequence[ShakeRecord], parameters: ShakeParameters) -> float:
    """Return the sum of squares of weighted residuals [1]: about 12 times `share` for each frequency."""
    total = float(np.sum(parameters.values[DELAY + 1 :] ** 2))
    for record in records:
        for part in chunks(record):
            total += 2 * record.share * float(np.sum(np.abs(evaluate(part, parameters).residual) ** 2))
    return total


def least_squares(rows: Array, damping: float = 0.0) -> Array:
    """Return the least-squares solution of rows, shape (k,); combinations that they do not determine stay at zero.

    `damping` is the Levenberg-Marquardt parameter, for columns of unit size [1].
    """
    table, target = rows[:, :-1], rows[:, -1]
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0] = 1.0
    full = np.vstack([table / scale, damping * np.eye(scale.size)])
    aim = np.concatenate([target, np.zeros(scale.size)])
    return np.asarray(np.linalg.lstsq(full, aim, rcond=ROUNDING)[0] / scale)


def first_guess(records: Sequence[ShakeRecord], *, sizes: Array) -> ShakeParameters:
    """Return parameters by iterated linear least squares: the equation itself is linear in them.

    Each round is weighted with the response of the one before; the delay and the systematic parameters are zero.

    Parameters
    ----------
    records
        What is fitted; of its frequencies every so many are used.
    sizes
        Sizes of the loads by which the components are weighted in the first round, shape (6,) [N, N*m].
    """
    noise = np.diag(np.min([record.noise for record in records], axis=0) ** 2)
    unknowns = tuple(dict.fromkeys(key for record in records for key in record.slopes))
    found = ShakeParameters(np.zeros(DELAY + 1 + len(unknowns)), noise, unknowns)
    step = max(sum(record.frequency.size for record in records) // ENOUGH_AT_FIRST, 1)
    records = [record.keep(slice(None, None, step)) for record in records]
    middle = float(np.exp(np.mean([np.mean(np.log(record.frequency)) for record in records])))
    for number in range(ROUNDS):
        products = np.zeros((DELAY + 1, DELAY + 1))
        for record in records:
            for part in chunks(record):
                if number:
                    weight = evaluate(part, found).weight
                else:  # noise grows with the square of the frequency in the equation
                    falls = 1 / (1 + (part.frequency / middle) ** 2)
                    weight = (falls[:, None, None] * np.diag(1 / sizes)).astype(np.complex128)
                products += _equation_products(part, weight)
        values = found.values.copy()
        values[:DELAY] = least_squares(rows_from_products(products))
        found = found.at(values)
    return found


def _equation_products(record: ShakeRecord, weight: Complex) -> Array:
    """Products of the weighted rows of the equation, with the readings as they are, shape (83, 83)."""
    matrices = [
        (weight[:, :, :, None] * part[:, None, None, :]).reshape(-1, 6, 36) for part in (record.seconds, record.rates)
    ]
    table = np.concatenate([*matrices, weight @ record.taken], axis=2)
    return products_of(table, np.einsum("mij,mj->mi", weight, record.loads), 1.0)


def settle(records: Sequence[ShakeRecord], start: ShakeParameters) -> ShakeParameters:
    """Return the most likely parameters, by the Levenberg-Marquardt method.

    Raises
    ------
    FitError
        The fit does not settle.
    """

    def step(here: ShakeParameters, damping: float) -> DampedStep[ShakeParameters]:
        rows = information_rows(records, here)
        move = least_squares(rows, damping)
        predicted = float(rows[:, -1] @ rows[:, -1] - np.sum((rows[:, -1] - rows[:, :-1] @ move) ** 2))
        trial = here.at(here.values + move)
        return DampedStep(predicted, lambda: (trial, squares_of(records, trial)))

    found = levenberg_marquardt(start, squares_of(records, start), step, SETTINGS)
    if found.settled:
        return found.state
    raise FitError(
        f"{', '.join(record.name for record in records)}: the fit of the shaken records does not settle; are all of "
        "one and the same balance and model, with no wind and nothing touching it?"
    )


def with_noise(records: Sequence[ShakeRecord], fit: ShakeParameters, *, least: Array) -> ShakeParameters:
    """Return the fit with the noise of the loads re-estimated: one step of expectation and maximisation.

    Parameters
    ----------
    records
        What was fitted.
    fit
        The parameters found.
    least
        Standard deviations that the noise has at least, shape (6,) [N, N*m].
    """
    total, count = np.zeros((6, 6)), 0
    for record in records:
        for part in chunks(record):
            here = evaluate(part, fit)
            total += np.real(here.load_noise.T @ np.conj(here.load_noise) + here.spread.sum(axis=0))
            count += part.frequency.size
    covariance = total / max(count - fit.values.size / 12, 1)  # 12 real residuals at a frequency
    deviation = np.maximum(np.sqrt(np.diag(covariance)), least)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    if (deviation <= least).any() or np.linalg.eigvalsh(correlation)[0] < 1e-3:
        correlation = np.eye(6)  # not noise but rounding, or a lack of fit that all components share
    return replace(fit, noise=np.asarray(correlation * np.outer(deviation, deviation)))
