"""Settings of the documentation build."""

import sys
from pathlib import Path

from sphinx.domains.python import PyObject

sys.path.insert(0, str(Path(__file__).parent))

project = "aerobalance"
author = "the aerobalance developers"
copyright = "2026, the aerobalance developers"  # noqa: A001 - the name that Sphinx reads
extensions = [
    "myst_parser",
    "mathml",
    "commandline",
    "other_projects",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_static", "inventories"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "aerobalance"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}

# where their lists of names cannot be asked for, those names that these pages use are kept here
OTHERS = {
    "numpy": "https://numpy.org/doc/stable/",
    "scipy": "https://docs.scipy.org/doc/scipy/",
    "pandas": "https://pandas.pydata.org/docs/",
    "xarray": "https://docs.xarray.dev/en/stable/",
}
intersphinx_mapping = {name: (address, (None, f"inventories/{name}.txt")) for name, address in OTHERS.items()}
intersphinx_timeout = 5
intersphinx_disabled_reftypes = ["std:*"]  # words in backticks are names, and no headings of theirs

# every script of examples/ is run, and becomes a page of its own
sphinx_gallery_conf = {
    "examples_dirs": ["../examples"],
    "gallery_dirs": ["examples"],
    "filename_pattern": r"\.py",
    "reset_modules": ("matplotlib", "gallery.doubts_are_errors"),
    "run_stale_examples": True,  # the library may have changed
    "capture_repr": (),
    "thumbnail_size": (700, 450),
    "min_reported_time": 1e9,  # seconds of a machine that nobody knows
    "notebook_extensions": set(),
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
}

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
