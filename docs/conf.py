"""Settings of the documentation build."""

project = "aerobalance"
author = "the aerobalance developers"
copyright = "2026, the aerobalance developers"  # noqa: A001 - the name that Sphinx reads
extensions = ["myst_parser"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "aerobalance"
