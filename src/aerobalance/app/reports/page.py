"""Pages: what the reports share, from the style of figures and the writing of numbers to the file itself.

Figures are drawn once, in place-holder colours that the page turns into the reader's light or dark ones.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aerobalance.io.safe_write import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Palette:
    """Colours of a figure: lettering, secondary lettering, grid, and four for data, as hexadecimal codes."""

    ink: str
    muted: str
    grid: str
    first: str
    second: str
    third: str
    fourth: str


PLACE_HOLDERS: Final = Palette("#010101", "#020202", "#030303", "#040404", "#050505", "#060606", "#070707")
"""Colours that the page replaces by its own, light or dark."""

PRINT: Final = Palette("#1c1c1c", "#5f6368", "#dddddd", "#8a94a0", "#c2410c", "#1d4ed8", "#00805a")
"""Colours of a picture on white."""

STYLE: Final[Any] = {
    "font.size": 10.0,
    "font.family": ["DejaVu Sans"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "text.parse_math": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


def empty_figure(
    colours: Palette,
    size: tuple[float, float],
    *,
    rows: int,
    columns: int = 1,
    heights: Sequence[float] | None = None,
    share: bool = False,
) -> tuple[Figure, list[Axes]]:
    """Empty figure with a grid of axes in the report's style, row by row."""
    from matplotlib import rc_context  # noqa: PLC0415 - loading takes a second; only reports need it
    from matplotlib.figure import Figure  # noqa: PLC0415

    paint: Any = {
        "text.color": colours.ink,
        "axes.labelcolor": colours.ink,
        "axes.edgecolor": colours.muted,
        "xtick.color": colours.muted,
        "ytick.color": colours.muted,
        "grid.color": colours.grid,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
    }
    with rc_context({**STYLE, **paint}):
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharex=share, height_ratios=heights)
    return figure, list(grid.ravel())


def legend(axes: Axes, colours: Palette, place: Any, *, columns: int = 1) -> None:
    """Add a legend in the page's style."""
    axes.legend(loc=place, ncols=columns, labelcolor=colours.ink, frameon=False, fontsize=9)


def legend_above(figure: Figure, axes: Axes, colours: Palette, *, columns: int) -> None:
    """Add a legend above the axes, across the whole figure: names beside narrow axes need the room on their left."""
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=columns,
        labelcolor=colours.ink,
        frameon=False,
        fontsize=9,
    )


def power_of_ten(value: float, _place: float = 0.0) -> str:
    """A number as a power of ten for an axis of them, such as 10⁻⁴; powers in mathematical type need a font more."""
    exponent = round(math.log10(value)) if value > 0 else 0
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def inline(figure: Figure, name: str, label: str) -> str:
    """Inline SVG of a figure: no addresses, ids of its own, place-holder colours turned into the page's variables."""
    from matplotlib import rc_context  # noqa: PLC0415 - loading takes a second; only reports need it

    buffer = io.StringIO()
    with warnings.catch_warnings(), rc_context({**STYLE, "svg.hashsalt": name, "svg.fonttype": "path"}):
        warnings.filterwarnings("ignore", "Glyph")  # a sign that the font lacks becomes a box
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    text = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg[^>]*?) height="[^"]*"', r"\1\2", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    for colour in fields(Palette):
        text = text.replace(getattr(PLACE_HOLDERS, colour.name), f"var(--{colour.name})")
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1)


def number(value: float | None, digits: int = 5) -> str:
    """Write a number for a table: significant digits, a true minus sign, powers of ten raised."""
    if value is None or not np.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, power = text.split("e")
        text = f"{mantissa}·10<sup>{int(power)}</sup>"
    return text.replace("-", "−")


def significant(value: float, digits: int) -> str:
    """Write a number rounded to significant digits, zeros at the end kept, without powers of ten."""
    if not value:
        return "0"
    places = digits - 1 - int(f"{value:.{digits - 1}e}".split("e")[1])  # the exponent after rounding
    return f"{round(value, places):.{max(0, places)}f}".replace("-", "−")


def fixed(value: float | None, places: int) -> str:
    """Write a number with so many decimals, and a dash for one that is not known."""
    if value is None or not np.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", "−")  # no minus before zeros alone


def decimals(u: float | None, *, most: int = 8) -> int:
    """Return the decimals at which a standard uncertainty keeps two digits."""
    if not u or not np.isfinite(u):
        return 3
    return min(most, max(0, 1 - int(np.floor(np.log10(u)))))


def with_uncertainty(value: float, u: float | None, scale: float = 1.0) -> str:
    """Write a value and its standard uncertainty, rounded to two digits of the uncertainty."""
    value = value / scale
    if not u:
        return number(value, 5)
    u = u / scale
    places = max(0, 1 - int(np.floor(np.log10(u))))
    return f"{value:.{places}f} <span class=u>± {u:.{places}f}</span>".replace("-", "−")


def sentence(text: str) -> str:
    """Return words as a sentence begins; a name that they begin with, such as a channel's, stays as it is."""
    first = text.split(maxsplit=1)[0] if text.strip() else ""
    return text if "_" in first else text[:1].upper() + text[1:]


def write_page(path: Path | str, template: str, content: Mapping[str, Any]) -> None:
    """Fill a page with figures and tables and write it, whole or not at all.

    Parameters
    ----------
    path
        The HTML file.
    template
        Its template, which extends `page.html.j2`.
    content
        What the template names.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - only reports need it
    from markupsafe import Markup  # noqa: PLC0415

    environment = Environment(
        loader=PackageLoader("aerobalance.app.reports"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["number"] = lambda value, digits=5: Markup(number(value, digits))
    environment.filters["sentence"] = sentence
    environment.filters["digits"] = significant
    environment.filters["fixed"] = fixed
    environment.filters["with_u"] = lambda pair, scale=1.0: Markup(with_uncertainty(pair[0], pair[1], scale))
    page = environment.get_template(template).render(content)
    with replacing(path) as beside:
        beside.write_text(page, encoding="utf-8")
