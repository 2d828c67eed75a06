"""What an extra of the package brings, and one clear line where it is missing."""

from __future__ import annotations

import importlib

from dieseltwin.errors import InputError


def require(package: str, extra: str, what: str) -> None:
    """Refuse to go on without a package that an extra brings.

    Args:
        package: what is imported.
        extra: the extra of `dieseltwin` that installs it.
        what: what was asked for, for the message.

    Raises:
        InputError: it cannot be imported.
    """
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise InputError(
            what, f"no {package}", f"an installation with the extra {extra}", f"pip install 'dieseltwin[{extra}]'"
        ) from error
