"""Text exports of measuring programs as bytes, all of the same readings."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

RATE = 5000.0
ROWS = 120
TIME = np.arange(ROWS) / RATE
BRIDGES = np.round(
    np.array([0.4, -0.3, 0.2, 0.1, -0.05, 0.6]) + 0.1 * np.sin(TIME[:, None] * [300, 500, 700, 900, 1100, 1300]), 6
)
"""Readings of six bridges, shape (n, 6) [mV/V]."""

PITCH = np.round(2.0 + 0.01 * np.cos(200 * TIME), 4)
"""Pitch, shape (n,) [deg]."""

GAUGES = ("rNF", "rPM", "rSF", "rYM", "rRM", "rAF")


@dataclass(frozen=True)
class Export:
    """One file: its name, its bytes, and the channel that each column is that a person has to name."""

    name: str
    content: bytes
    names: dict[int, str]
    """By number of the column."""


def _comma(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def _table(separator: str, rows: list[list[str]], end: str = "\r\n") -> str:
    return "".join(separator.join(row) + end for row in rows)


def _bridges(first: int) -> dict[int, str]:
    return {first + i: name for i, name in enumerate(GAUGES)}


def labview_german() -> Export:
    preamble = [
        ["Messprotokoll Niedergeschwindigkeits-Windkanal"],
        ["Versuch", "17"],
        ["Bearbeiter", "Jürgen Größ"],
        ["Abtastrate", "5000 Hz"],
        ["Datum", "12.03.2024"],
        ["Bemerkung", "Modell hängt frei; 20 °C"],
        [""],
    ]
    header = [
        "Zeitstempel",
        "X_Value (s)",
        *(f"Brücke {i} (mV/V)" for i in range(1, 7)),
        "Nickwinkel (°)",
        "Bemerkung",
    ]
    rows = [
        [
            f"12.03.2024 10:15:{_comma(3 + t, 4).zfill(7)}",
            _comma(t, 6),
            *(_comma(x, 6) for x in row),
            _comma(p, 4),
            "ok",
        ]
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("lauf_017.csv", _table(";", [*preamble, header, *rows]).encode("cp1252"), _bridges(3))


def labview_french() -> Export:
    preamble = "Essai de la balance\r\nOpérateur :\tRenée\r\nFréquence d'échantillonnage :\t5000 Hz\r\n\r\n"
    header = ["Temps [s]", *(f"Pont {i} [µV/V]" for i in range(1, 7)), "Angle de tangage [°]", "Commentaire"]
    rows = [
        [_comma(t, 4), *(_comma(1000 * x, 3) for x in row), _comma(p, 4)]  # no cell for the comment
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("essai.txt", ("\ufeff" + preamble + _table("\t", [header, *rows])).encode(), _bridges(2))


def labview_english() -> Export:
    names = [f"Bridge {i}" for i in range(1, 7)]
    head = [
        ["waveform", *names, "Pitch"],
        ["t0", *["3/12/2024 10:15:03.125 PM"] * 7],
        ["delta t", *["0.000200"] * 7],
        [],
        ["time", *(f"{name} [mV/V]" for name in names), "Pitch [deg]"],
    ]
    rows = [
        [f"3/12/2024 10:15:{3.125 + t:06.3f} PM", *(f"{x:.6E}" for x in row), f"{p:.6E}"]
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("export.txt", _table("\t", [*head, *rows]).encode("ascii"), _bridges(2))


def _lvm(comma: bool, x_columns: str) -> bytes:
    def number(value: float) -> str:
        return _comma(value, 6) if comma else f"{value:.6f}"

    sign, stamp = ",."[not comma], "10:15:03,1234567890123456789" if comma else "10:15:03.1234567890123456789"
    units = ["mV/V"] * 6 + ["deg"]
    names = [f"Untitled {i}" for i in range(1, 7)] + ["pitch"]
    file_head = [
        ["LabVIEW Measurement", ""], ["Writer_Version", "2"], ["Reader_Version", "2"], ["Separator", "Tab"],
        ["Decimal_Separator", sign], ["Multi_Headings", "Yes"], ["X_Columns", x_columns], ["Time_Pref", "Relative"],
        ["Operator", "lab"], ["Date", "2024/03/12"], ["Time", stamp], ["***End_of_Header***", ""], [""],
    ]  # fmt: skip
    head = [
        ["Channels", "7", *[""] * 7], ["Samples", *[str(ROWS)] * 7, ""], ["Date", *["2024/03/12"] * 7, ""],
        ["Time", *[stamp] * 7, ""], ["Y_Unit_Label", *units, ""], ["X_Dimension", *["Time"] * 7, ""],
        ["X0", *["0.0000000000000000E+0".replace(".", sign)] * 7, ""], ["Delta_X", *[number(1 / RATE)] * 7, ""],
        ["***End_of_Header***", *[""] * 8], ["X_Value", *names, "Comment"],
    ]  # fmt: skip
    rows = [
        ["" if x_columns == "No" else number(t), *(number(x) for x in row), number(p)]
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    rows[5].append("gust on")
    return _table("\t", [*file_head, *head, *rows]).encode("cp1252")


def lvm_english() -> Export:
    return Export("run.lvm", _lvm(comma=False, x_columns="One"), _bridges(2))


def lvm_german() -> Export:
    return Export("lauf.lvm", _lvm(comma=True, x_columns="No"), _bridges(2))


def diadem() -> Export:
    names = ["Zeitkanal", *(f"DMS_{i}" for i in range(1, 7)), "Nickwinkel"]
    comments = ["Zeit seit Trigger", *["Sechskomponentenwaage intern"] * 6, "Neigungsgeber"]
    units = ["s", *["mV/V"] * 6, "°"]
    head = [["Gruppe: Lauf 17"], ["Autor: Größ"], names, comments, units]
    rows = [
        [_comma(t, 4), *(_comma(x, 6) for x in row), _comma(p, 4)]
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("diadem.csv", _table(";", [*head, *rows]).encode("cp1252"), _bridges(2))


def dewesoft() -> Export:
    head = [
        ["FileName:", "C:\\Data\\run17.dxd"],
        ["Start time:", "3/12/2024 10:15:03.123 AM"],
        ["Sample rate:", "5000 Hz"],
        ["Number of channels:", "7"],
        ["Store type:", "always fast"],
        [],
        ["Data1"],
        ["Time (s)", *(f"AI {i} (mV/V)" for i in range(1, 7)), "pitch (deg)"],
    ]
    rows = [
        [f"{t:.6f}", *(f"{x:.6f}" for x in row), f"{p:.4f}"] for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("dewesoft.txt", _table("\t", [*head, *rows]).encode(), _bridges(2))


def catman() -> Export:
    head = [
        ["HBM_CATMAN_DATAFILE_40", ""],
        ["Erstellt:", "12.03.2024 10:15:03", ""],
        ["Messrate", "5000 Hz", ""],
        ["Werte:", str(ROWS), ""],
        ["", ""],
        ["Zeit  1 - Schnelle Messrate", *(f"MX840B_CH {i}" for i in range(1, 7)), "Nickwinkel", ""],
        ["s", *["mV/V"] * 6, "°", ""],
        ["T0 = 12.03.2024 10:15:03", *["SR = 5000 Hz"] * 7, ""],
    ]
    rows = [
        [_comma(t, 6), *(_comma(x, 6) for x in row), _comma(p, 4), ""]
        for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    return Export("catman.asc", _table("\t", [*head, *rows]).encode("cp1252"), _bridges(2))


def simcenter() -> Export:
    head = (
        "Simcenter Testlab - Export to text file\r\nProject: balance.lms\r\nSection: Section1\r\nRun: Run 17\r\n"
        "Increment: 2.000000e-04 s\r\nNumber of samples: 120\r\n\r\n"
    )
    names = ["Time", *(f"bal:{i}:S" for i in range(1, 7)), "mod:pitch"]
    units = ["[s]", *["[mV/V]"] * 6, "[deg]"]
    rows = [
        [f"{t:.6e}", *(f"{x:.8e}" for x in row), f"{p:.6e}"] for t, row, p in zip(TIME, BRIDGES, PITCH, strict=True)
    ]
    text = "".join("".join(f"{cell:>18}" for cell in row) + "\r\n" for row in [names, units, *rows])
    return Export("testlab.txt", (head + text).encode("utf-16"), {**_bridges(2), 8: "pitch"})


def excel_german() -> Export:
    names = ["Datum", "Uhrzeit", *(f"Kraft {i}" for i in range(1, 7)), "Nickwinkel"]
    units = ["", "hh:mm:ss", *["mV/V"] * 6, "°"]
    clock = [
        f"23:59:{_comma(59.99 + t, 4)}" if t < 0.01 else f"00:00:{_comma(t - 0.01, 4).zfill(7)}"
        for t in np.round(TIME, 4)
    ]
    rows = [
        ["12.03.2024", t, *(_comma(x, 6) for x in row), _comma(p, 4)]
        for t, row, p in zip(clock, BRIDGES, PITCH, strict=True)
    ]
    text = _table(";", [["Windkanal", *[""] * 8], [""] * 9, names, units, *rows, [""] * 9, [""] * 9])
    return Export("tabelle.csv", ("\ufeff" + text).encode(), _bridges(3))


def excel_english() -> Export:
    names = [
        '"Sample, no."',
        '"Elapsed time (ms)"',
        *(f'"Gauge {i} (uV/V)"' for i in range(1, 7)),
        '"pitch (deg)"',
        '"Note"',
    ]
    rows = [
        [str(i + 1), f"{1000 * t:.1f}", *(f"{1000 * x:.3f}" for x in row), f"{p:.4f}", '"wind on, 40 m/s"']
        for i, (t, row, p) in enumerate(zip(TIME, BRIDGES, PITCH, strict=True))
    ]
    text = _table(",", [['"Run 17"', *[""] * 9], ["Sample rate", "5 kHz", *[""] * 8], names, *rows])
    return Export("book.csv", text.encode(), _bridges(3))


EXPORTS: tuple[Callable[[], Export], ...] = (
    *(labview_german, labview_french, labview_english, lvm_english, lvm_german, diadem, dewesoft, catman, simcenter),
    *(excel_german, excel_english),
)
"""Every export, made when called."""


def completed(text: str, names: dict[int, str]) -> str:
    """Complete a proposed map by what the columns are, and by nothing else."""
    for number, name in names.items():
        head = f"# [channels.column_{number}]"
        if f"{head}  #" not in text:
            raise AssertionError(f"column {number} is not proposed as unassigned:\n{text}")
        before, after = text.split(head, 1)
        table, _, rest = after.partition("\n\n")
        text = before + f"[channels.{name}]" + table.replace("\n# ", "\n") + ("\n\n" + rest if rest else "")
    return text
