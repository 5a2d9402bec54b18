"""Names of other projects in annotations, as these projects spell them: so that they lead to their pages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

SPELT: Final = {
    "Array": "numpy.ndarray",  # of float64, as the page says
    "ArrayLike": "numpy.typing.ArrayLike",
    "NDArray": "numpy.typing.NDArray",
    "np.": "numpy.",
    "pd.": "pandas.",
    "xr.": "xarray.",
}
"""Whole names, and beginnings of names."""


def spell(_app: Sphinx, _environment: BuildEnvironment, node: nodes.Element, _text: nodes.Element) -> None:
    """Write out the target of a reference that leads nowhere here."""
    target = node.get("reftarget", "").strip("'")
    name, dot, rest = target.partition(".")
    whole = SPELT.get(f"{name}{dot}")
    if node.get("refdomain") == "py" and whole is not None:
        node["reftarget"], node["reftype"] = f"{whole}{rest}", "obj"  # what is an alias here is no class there


def setup(app: Sphinx) -> dict[str, bool]:
    """Spell names before intersphinx looks for them."""
    app.connect("missing-reference", spell, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
