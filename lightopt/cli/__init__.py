"""The command line: parses, calls one function of the library, says where the result is.

The one place that turns errors into messages and exit statuses. Importing it must stay cheap: commands import what
they need when they run.
"""

from lightopt.cli._main import main

__all__ = ["main"]
