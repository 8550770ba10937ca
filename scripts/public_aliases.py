"""For the documentation site: what a package imports under its own name, ``from a import x as x``, is public."""

import ast
from typing import Any

import griffe


class PublicAliases(griffe.Extension):
    """Marks such names, which mkdocstrings takes for private."""

    def on_alias_instance(self, *, node: Any, alias: griffe.Alias, **_: Any) -> None:
        """Called for each imported name."""
        if isinstance(node, ast.ImportFrom) and any(one.asname == one.name == alias.name for one in node.names):
            alias.public = True
