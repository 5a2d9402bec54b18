"""balance.json: a balance matrix with everything that its loads and their uncertainty need, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Unpack

import numpy as np
from pydantic import Field

from aerobalance.balance.load_formats import Geometry
from aerobalance.balance.matrix import BalanceMatrix, TemperatureEffect
from aerobalance.balance.terms import by_label
from aerobalance.io import artefacts
from aerobalance.io.artefacts import Finite, NotNegative, Positive
from aerobalance.io.balfit_matrix import is_balfit_matrix, read_balfit_matrix
from aerobalance.io.opening import opened_file
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import ReadError

if TYPE_CHECKING:  # the fit brings a statistics library that only calibrating needs, and that is slow to import
    from aerobalance.balance.calibration.fit import Calibration
    from aerobalance.balance.calibration.quality import Direction, Quality
    from aerobalance.balance.calibration.regression import Regression


class _Geometry(artefacts.Loose):
    forward_normal: Positive
    aft_normal: Positive
    forward_side: Positive
    aft_side: Positive


class _Temperature(artefacts.Loose):
    reference: Finite
    zero: Finite
    u_zero: NotNegative = 0.0
    sensitivity: Finite
    u_sensitivity: NotNegative = 0.0


class _MatrixValues(artefacts.Loose):
    components: Annotated[list[str], Field(min_length=1)]
    gauges: Annotated[list[str], Field(min_length=1)]
    way: Literal["iterative", "non-iterative"]
    terms: Annotated[list[str], Field(min_length=1)]
    coefficients: list[list[Finite]]
    load_scale: list[Positive]
    output_scale: list[Positive]
    covariance: list[list[list[Finite]]] | None = None
    residual_deviation: list[NotNegative] | None = None
    residual_correlation: list[list[Finite]] | None = None
    degrees_of_freedom: list[Annotated[int, Field(ge=0)]] | None = None
    calibrated: list[list[Finite]] | None = None
    natural_zero: list[Finite] | None = None
    moments: list[bool]
    balance_type: Literal["force", "moment", "direct", "unknown"] = "unknown"
    geometry: _Geometry | None = None
    temperature: dict[str, _Temperature] = Field(default_factory=dict)
    reading_noise: Finite | list[Finite] = 0.0


class _BalanceFile(artefacts.Loose):
    for_people = artefacts.IN_EVERY_FILE | {
        "calibration",
        "model",
        "way",
        "points",
        "series",
        "components",
        "unidentified_terms",
        "unidentified_because",
        "condition_number",
        "tares",
        "outliers",
        "assumptions",
    }

    kind: Literal["balance"] = "balance"
    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    matrix: _MatrixValues


def calibration_payload(calibration: Calibration, quality: Quality) -> dict[str, object]:
    """Return what a calibration found, as plain data: statistics by component, terms, tares, outliers."""
    schedule, matrix = calibration.schedule, calibration.matrix
    payload: dict[str, object] = {
        "calibration": schedule.name,
        "model": calibration.model,
        "way": calibration.way,
        "points": int(np.count_nonzero(schedule.fitted)),
        "series": len(schedule.series_names),
        "components": {
            name: _component(calibration, quality, index) for index, name in enumerate(schedule.components)
        },
        "unidentified_terms": list(calibration.unidentified_labels),
        "unidentified_because": {
            item.term.label(matrix.variables): (
                "the loads never bring it out"
                if item.like is None
                else f"looks like {item.like.label(matrix.variables)}"
            )
            for item in calibration.unidentified
        },
        "condition_number": calibration.condition,
        "tares": _tares(calibration),
        "outliers": [
            {
                "point": schedule.points[item.point],
                "series": schedule.series_names[schedule.series[item.point]],
                "label": item.label,
                "component": schedule.components[item.component],
                "residual": item.residual,
                "unit": "mV/V",
                "studentised": item.deviations,
                "studentised_text": item.size,
                "load": item.load,
                "load_read": item.load_read,
                "load_unit": "N*m" if schedule.moments[item.component] else "N",
                "cause": item.cause,
            }
            for item in quality.outliers
        ],
        "left_out": list(schedule.left_out),
        "assumptions": list(schedule.assumptions),
    }
    return payload


def _component(calibration: Calibration, quality: Quality, index: int) -> dict[str, object]:
    schedule, matrix, fit = calibration.schedule, calibration.matrix, calibration.regressions[index]
    unit = "N*m" if schedule.moments[index] else "N"
    linear = next(row for row, term in enumerate(matrix.terms) if term.kind == 0 and term.first == index)
    scale = (
        matrix.output_scale[index] / matrix.load_scale[index]
        if matrix.way == "iterative"
        else matrix.load_scale[index] / matrix.output_scale[index]
    )
    sensitivity_unit = f"mV/V/({unit})" if matrix.way == "iterative" else f"{unit}/(mV/V)"
    # residuals of the outputs count as load by the output at capacity
    press = fit.press
    entry: dict[str, object] = {
        "unit": unit,
        "file_unit": schedule.load_units[index],
        "gauge": matrix.gauges[index],
        "capacity": {"value": float(schedule.capacities[index]), "u": 0.0, "unit": unit},
        "calibrated": {"value": matrix.calibrated[:, index].tolist(), "unit": unit},
        "sensitivity": {
            "value": float(fit.coefficients[linear] * scale),
            "u": float(np.sqrt(fit.covariance[linear, linear]) * scale),
            "unit": sensitivity_unit,
        },
        "residual_std_percent_of_capacity": 100 * float(quality.deviation[index]),
        "residual_std_percent_of_half_range": 100 * float(quality.of_half_range[index]),
        "residual_largest_percent_of_capacity": 100 * float(quality.largest[index]),
        "residual_largest_percent_of_half_range": 100
        * float(quality.largest[index] * schedule.capacities[index] / (np.ptp(matrix.calibrated[:, index]) / 2)),
        "press_percent_of_capacity": 100 * press,
        "r_squared": fit.r_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "hysteresis_percent_of_capacity": 100 * float(quality.hysteresis[index]),
        "repeatability_percent_of_capacity": 100 * float(quality.repeatability[index]),
        **_direction(quality.directions[index]),
        "terms": _terms(matrix, fit, index),
    }
    if quality.confirmation is not None and quality.confirmation_covered is not None:
        entry["confirmation_std_percent_of_capacity"] = 100 * float(quality.confirmation[index])
        entry["confirmation_within_two_u_percent"] = 100 * float(quality.confirmation_covered[index])
    effect = matrix.temperature.get(schedule.components[index])
    if effect is not None:
        entry["temperature"] = {
            "zero": {"value": effect.zero, "u": effect.u_zero, "unit": "mV/V/K"},
            "sensitivity": {"value": effect.sensitivity, "u": effect.u_sensitivity, "unit": "1/K"},
        }
    return entry


def _direction(direction: Direction) -> dict[str, object]:
    if not direction.known:
        return {"bidirectional": None, "sensitivity_difference_percent": None, "bidirectional_p": None}
    return {
        "bidirectional": direction.bidirectional,
        "sensitivity_difference_percent": 100 * direction.difference,
        "bidirectional_p": direction.p,
    }


def _terms(matrix: BalanceMatrix, fit: Regression, index: int) -> list[dict[str, object]]:
    """Table of the terms of one component, for scaled loads and outputs."""
    # the regression has the terms of the whole matrix, in its order; contribution is at capacity of every load
    return [
        {
            "term": term.label(matrix.variables),
            "value": float(fit.coefficients[row]),
            "u": float(np.sqrt(fit.covariance[row, row])),
            "t": float(fit.t[row]),
            "p": float(fit.p[row]),
            "vif": float(fit.vif[row]),
            "percent_contribution": 100 * float(fit.coefficients[row] / _own(matrix, fit, index)),
        }
        for row, term in enumerate(matrix.terms)
        if fit.included[row]
    ]


def _own(matrix: BalanceMatrix, fit: Regression, index: int) -> float:
    row = next(row for row, term in enumerate(matrix.terms) if term.kind == 0 and term.first == index)
    return abs(float(fit.coefficients[row])) or 1.0


def _tares(calibration: Calibration) -> dict[str, object]:
    schedule = calibration.schedule
    if calibration.tares_by_iteration is None:
        return {"known": False, "because": "the file has no natural zeros: only loads from the zero of a series count"}
    difference = np.nanmax(np.abs(calibration.tares - calibration.tares_by_iteration) / schedule.capacities)
    return {
        "known": True,
        "series": {
            name: {
                component: {
                    "value": float(calibration.tares[number, i]),
                    "u": float(calibration.u_tares[number, i]),
                    "unit": "N*m" if schedule.moments[i] else "N",
                }
                for i, component in enumerate(schedule.components)
            }
            for number, name in enumerate(schedule.series_names)
        },
        "largest_difference_of_both_methods_percent_of_capacity": 100 * float(difference),
    }


def matrix_payload(matrix: BalanceMatrix) -> dict[str, object]:
    """Return a matrix as plain data, from which `read_balance` makes it again."""
    geometry = matrix.geometry
    return {
        "components": list(matrix.components),
        "gauges": list(matrix.gauges),
        "way": matrix.way,
        "scaling": "loads over load_scale [N, N*m], outputs less zero over output_scale [mV/V]",
        "terms": [term.label(matrix.variables) for term in matrix.terms],
        "coefficients": matrix.coefficients.tolist(),
        "load_scale": matrix.load_scale.tolist(),
        "output_scale": matrix.output_scale.tolist(),
        "residual_deviation": matrix.residual_deviation.tolist(),
        "residual_correlation": matrix.residual_correlation.tolist(),
        "degrees_of_freedom": matrix.degrees_of_freedom.tolist(),
        "calibrated": matrix.calibrated.tolist(),
        "natural_zero": None if matrix.natural_zero is None else matrix.natural_zero.tolist(),
        "moments": matrix.moments.tolist(),
        "balance_type": matrix.balance_type,
        "geometry": None if geometry is None else {name: getattr(geometry, name) for name in _Geometry.model_fields},
        "temperature": {
            name: {key: getattr(effect, key) for key in _Temperature.model_fields}
            for name, effect in matrix.temperature.items()
        },
        "reading_noise": np.asarray(matrix.reading_noise).tolist(),
        "covariance": matrix.covariance.tolist(),
    }


def write_balance(
    path: Path | str,
    matrix: BalanceMatrix,
    *,
    found: Mapping[str, object],
    **origin: Unpack[artefacts.Origin],
) -> None:
    """Write balance.json.

    Parameters
    ----------
    path
        The file.
    matrix
        The matrix.
    found
        How the calibration went (`calibration_payload`).
    origin
        What it was computed from.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    contents = {**found, "matrix": matrix_payload(matrix)}
    artefacts.write_artefact(path, "balance", contents, **origin)


def read_balance(path: Path | str) -> BalanceMatrix:
    """Read the matrix of balance.json.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are no matrix; the message names the key and what is allowed.
    """
    file = Path(path)
    given = artefacts.load(file, "balance", _BalanceFile).matrix
    c, t = len(given.components), len(given.terms)
    variables = tuple(given.components if given.way == "iterative" else [f"r{name}" for name in given.gauges])
    labels = by_label(variables)
    unknown = [label for label in given.terms if label not in labels]
    if unknown:
        raise ReadError(file, "matrix.terms", f"{unknown[0]!r} is no term; examples: {', '.join(list(labels)[:9:3])}")
    zero, scale = np.zeros((c, t, t)), np.array(given.load_scale)
    try:
        return BalanceMatrix(
            components=tuple(given.components),
            gauges=tuple(given.gauges),
            way=given.way,
            terms=tuple(labels[label] for label in given.terms),
            coefficients=_array(given.coefficients),
            load_scale=scale,
            output_scale=np.array(given.output_scale),
            covariance=zero if given.covariance is None else _array(given.covariance),
            residual_deviation=_array(given.residual_deviation, np.zeros(c)),
            residual_correlation=_array(given.residual_correlation, np.eye(c)),
            degrees_of_freedom=np.array(given.degrees_of_freedom or [0] * c, dtype=np.intp),
            calibrated=_array(given.calibrated, np.array([-scale, scale])),
            natural_zero=None if given.natural_zero is None else np.array(given.natural_zero),
            moments=np.array(given.moments, dtype=bool),
            balance_type=given.balance_type,
            geometry=None if given.geometry is None else Geometry(**given.geometry.model_dump()),
            temperature={name: TemperatureEffect(**effect.model_dump()) for name, effect in given.temperature.items()},
            reading_noise=(
                np.array(given.reading_noise) if isinstance(given.reading_noise, list) else given.reading_noise
            ),
        )
    except ValueError as error:
        raise ReadError(file, "matrix", str(error)) from None


def _array(rows: Any, default: Array | None = None) -> Array:
    """Rows of numbers as an array; ragged ones are refused."""
    if rows is None:
        if default is None:
            raise ValueError("a table of numbers is missing")
        return default
    try:
        return np.array(rows, dtype=np.float64)
    except ValueError:
        raise ValueError("the rows of a table have different lengths") from None


def is_matrix(path: Path) -> bool:
    """Return whether a file holds a balance matrix, in balance.json or in the text layout of BALFIT."""
    head = "" if path.is_dir() else _head(path)  # some recordings are folders
    return is_balfit_matrix(head) or (head.lstrip("\ufeff \r\n").startswith("{") and '"balance"' in head)


def read_matrix(path: Path) -> BalanceMatrix:
    """Read a matrix from balance.json or from the text layout of BALFIT.

    Raises
    ------
    ReadError
        The file cannot be read as either.
    """
    return read_balfit_matrix(path) if is_balfit_matrix(_head(path)) else read_balance(path)


def _head(path: Path) -> str:
    with opened_file(path) as file:
        return file.read(4096).decode("latin-1").replace("\x00", "")
