"""Settings of the documentation build."""

import sys
from pathlib import Path

from sphinx.domains.python import PyObject

sys.path.insert(0, str(Path(__file__).parent))

project = "aerobalance"
author = "the aerobalance developers"
copyright = "2026, the aerobalance developers"  # noqa: A001 - the name that Sphinx reads
extensions = ["myst_parser", "mathml", "commandline", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_static"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "aerobalance"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}

# single backticks in docstrings are names of the library
default_role = "py:obj"
suppress_warnings = ["ref.python"]  # such a name may be an attribute of several classes
autodoc_typehints = "description"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_typehints_description_target = "documented_params"
python_use_unqualified_type_names = True
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_ivar = True

for field in PyObject.doc_field_types:
    if field.name == "variable":
        field.label = "Attributes"  # as the docstrings call them
