"""Configuration of the documentation site: `make docs` builds it into out/docs."""

from dataclasses import is_dataclass
from typing import Any

from sphinx.application import Sphinx

import inhand

project = "inhand"
author = "inhand developers"
copyright = "inhand developers"
version = release = inhand.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"inhand {version}"
html_show_sourcelink = False
html_copy_source = False

myst_heading_anchors = 3

# Docstrings write code in single quotes, as Markdown does.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_google_docstring = True
napoleon_numpy_docstring = False


def setup(app: Sphinx) -> None:
    """Adapt what autodoc finds."""
    app.connect("autodoc-process-docstring", _keep_colons, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", _hide_fields)


def _keep_colons(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """In the first line of an attribute's docstring, napoleon takes "words:" for a type."""
    if what in ("attribute", "property"):
        lines.insert(0, "")


def _hide_fields(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str, returned: str
) -> tuple[str, None] | None:
    """The fields of a dataclass are listed with their meaning; its signature would repeat them."""
    return ("", None) if what == "class" and is_dataclass(obj) else None
