r"""Formulas of these pages as MathML, which browsers draw themselves: no script, and no other server is asked.

A formula that ends with ``\tag{17}`` stands with that number beside it, at the address ``#equation-17``.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

NUMBER = re.compile(r"\s*\\tag\{(\w+)\}\s*$")


def inline(writer: HTML5Translator, node: nodes.math) -> None:
    """Write a formula in a line of text."""
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on a line of its own, with its number where it has one."""
    text = node.astext().strip()
    found = NUMBER.search(text)
    drawn = tex2mathml(NUMBER.sub("", text), as_block=True)
    address = f' id="equation-{found[1]}"' if found else ""
    number = f'<span class="number">({found[1]})</span>' if found else ""
    writer.body.append(f'<div class="formula"{address}><div class="drawn">{drawn}</div>{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Make ``mathml`` known to Sphinx as a way to write formulas."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
